"""Reward terms against values worked out by hand."""

import math

import pytest
import torch

from aicpg_newton.env import rewards
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.rewards import RewardTerm
from aicpg_newton.env.view import View
from aicpg_newton.errors import UserError
from aicpg_newton.robot import rotations


def test_head_height_and_survival(view_of):
    """R_h is the height of the head and R_a is one."""
    view = view_of(head_position=torch.tensor([[9.0, 8.0, 1.5], [0.0, 0.0, 1.2]]))
    assert rewards.head_height(view).tolist() == pytest.approx([1.5, 1.2])
    assert rewards.survival(view).tolist() == [1.0, 1.0]


def test_action_energy(view_of):
    """Eq. 6 in the unit of torque: |0.5 x 0.1 x 4| + 0.25 for one joint, the square for another that stands still."""
    torque, velocity = torch.zeros(1, 28), torch.zeros(1, 28)
    torque[0, 3], velocity[0, 3] = -25.0, 4.0
    torque[0, 7] = 10.0
    unit = torch.full((28,), 50.0)
    unit[7] = 20.0
    view = view_of(joint_velocity=velocity, torque=torque, torque_unit=unit)
    assert rewards.action_energy(view, 0.1).item() == pytest.approx(0.2 + 0.25 + 0.25)
    assert rewards.action_energy(view, 1.0).item() == pytest.approx(2.0 + 0.25 + 0.25)


def test_upright(view_of):
    """R_s is 1 upright, cos 60 degrees tilted by 60 degrees whatever the yaw, 0 lying."""
    tilt = torch.tensor([0.0, math.pi / 3, math.pi / 2])
    q = rotations.from_roll_pitch_yaw(torch.zeros(3), tilt, torch.tensor([0.3, 2.0, -1.0]))
    assert rewards.upright(view_of(root_rotation=q)).tolist() == pytest.approx([1.0, 0.5, 0.0], abs=1e-6)


def test_target_velocity(view_of):
    """R_d is the velocity along the target direction, negative when going back."""
    velocity = torch.tensor([[2.0, 1.0, 9.0], [2.0, 1.0, 9.0], [-2.0, 0.0, 0.0]])
    view = view_of(root_linear_velocity=velocity, heading=torch.tensor([0.0, math.pi / 2, 0.0]))
    assert rewards.target_velocity(view).tolist() == pytest.approx([2.0, 1.0, -2.0], abs=1e-6)


@pytest.mark.parametrize(
    ("reading", "bound", "reward"),
    [
        ("sum_of_magnitudes", 3.5, 0.5),
        ("magnitude_of_sum", 2.5, 0.9),
        ("sum_of_magnitudes", 1.75, 0.0),
        ("sum_of_magnitudes", 0.5, 0.0),
    ],
)
def test_pattern_tracking(view_of, reading: rewards.PatternError, bound: float, reward: float):
    """R_g falls on a straight line from 1 at no error to 0 at b, and stays there (Eq. 8).

    Errors of opposite sign cancel in Eq. 7 as printed and add up in the sum of magnitudes: 1 and -0.75 rad.
    """
    target, position = torch.zeros(1, 28), torch.zeros(1, 28)
    target[0, 0], position[0, 1] = 1.0, 0.75
    view = view_of(joint_position=position, target=target)
    assert rewards.pattern_tracking(view, bound, reading).item() == pytest.approx(reward)
    assert rewards.pattern_tracking(view_of(joint_position=target, target=target), bound, reading).item() == 1.0


def stillness(view: View, scale: float) -> torch.Tensor:
    """A term that somebody has thought of: 1 where the pelvis does not move."""
    return torch.exp(-scale * view.state.root_linear_velocity.norm(dim=1))


def test_a_new_term_is_declared_once(puppet, pattern):
    """Function, weight and parameters, in the task: it is paid, logged and checked."""
    task = get_task("flat")
    task.rewards["stillness"] = RewardTerm(stillness, 2.0, {"scale": 3.0})
    engine = puppet(2)
    engine.overrides = {"root_linear_velocity": torch.tensor([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]])}
    environment = Environment(task, engine, pattern)
    environment.step(torch.zeros(2, 28))
    assert environment.outcome.reward_terms["stillness"].tolist() == pytest.approx([0.02 * math.exp(-1.5), 0.02])
    environment.episode_length_buf[:] = 999
    log = environment.step(torch.zeros(2, 28))[3]["log"]
    assert float(log["Episode_Reward/stillness"]) == pytest.approx(0.02 * (1 + math.exp(-1.5)) / 2)
    task.rewards["stillness"].parameters = {"speed": 3.0}
    with pytest.raises(UserError, match=r"rewards\.stillness has the parameters \['speed'\].*takes \['scale'\]"):
        task.validate()
