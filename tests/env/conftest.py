"""Views of robots in made-up states."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from aicpg_newton.engines import RobotState
from aicpg_newton.env.commands import Commands
from aicpg_newton.env.view import View
from aicpg_newton.robot import humanoid, rotations


@pytest.fixture
def random_state() -> Callable[..., RobotState]:
    """A function that draws every number of a state at random."""

    def make(num_envs: int, seed: int = 0) -> RobotState:
        generator = torch.Generator().manual_seed(seed)

        def draw(*shape: int) -> torch.Tensor:
            return torch.randn(num_envs, *shape, generator=generator)

        angles = 0.8 * draw(3)
        return RobotState(
            root_position=draw(3),
            root_rotation=rotations.from_roll_pitch_yaw(angles[:, 0], angles[:, 1], 3 * angles[:, 2]),
            root_linear_velocity=draw(3),
            root_angular_velocity=draw(3),
            joint_position=draw(28),
            joint_velocity=draw(28),
            joint_torque=50 * draw(28),
            head_position=draw(3),
            foot_force=300 * draw(2, 3),
            foot_moment=30 * draw(2, 3),
        )

    return make


@pytest.fixture
def view_of(random_state) -> Callable[..., View]:
    """A function that makes a view of a state on a plane; what is not given is zero, and the state random."""

    def make(given_state: RobotState | None = None, num_envs: int = 1, *, heading=0.0, speed=None, **others) -> View:
        given = {name: others.pop(name) for name in list(others) if name in RobotState.__dataclass_fields__}
        sizes = [len(each) for each in (*given.values(), *others.values()) if isinstance(each, torch.Tensor)]
        state = replace(given_state or random_state(max([num_envs, *sizes])), **given)
        number = len(state.root_position)
        row = torch.zeros(number)
        told = Commands(row + 1.0, row + torch.as_tensor(heading), None if speed is None else row + speed)
        rest = torch.zeros(number, 28)
        made = {"ground_height": row, "terrain": None, "motors": humanoid.motors(), "torque": rest}
        made |= {"target": rest, "target_velocity": rest, "torque_unit": humanoid.motors().torque_limit}
        return View(state=state, commands=told, **{**made, **others})

    return make
