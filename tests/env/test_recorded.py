"""Rewards and observations in recorded states are what they were before they were declared as terms and blocks.

The states are of humanoids on uneven ground in MuJoCo, 45 steps into episodes with random actions; the numbers are
those of revision 97328e8, whose unit of torque was the limit. In one environment on one machine they are equal bit for
bit.
"""

from pathlib import Path

import pytest
import torch

from aicpg_newton.engines import RobotState
from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.env.commands import Commands
from aicpg_newton.env.methods import METHODS, get_method
from aicpg_newton.env.observations import observe
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.style import style_state
from aicpg_newton.env.task import SpeedTask
from aicpg_newton.env.view import View


@pytest.mark.parametrize("name", METHODS)
def test_recorded_states_look_and_pay_as_before(name: str):
    """All blocks and all terms, of each method."""
    recorded = torch.load(Path(__file__).with_name("recorded.pt"), weights_only=True)[name]
    method, task = get_method(name), get_task("uneven", name)
    task.ground.length, task.ground.width = 24.0, 16.0
    terrain = Terrain.make(task.ground)
    assert terrain is not None
    state = RobotState(**recorded["state"])
    speed = torch.full_like(recorded["heading"], task.target_speed) if isinstance(task, SpeedTask) else None
    view = View(
        state=state,
        ground_height=terrain.height(state.root_position),
        commands=Commands(recorded["frequency"], recorded["heading"], speed),
        terrain=terrain,
        motors=task.motors(),
        torque=recorded["torque"],
        torque_unit=task.motors().torque_limit,
        target=recorded["target"],
        target_velocity=recorded["target_velocity"],
    )
    torch.testing.assert_close(observe(method.actuation.blocks, view), recorded["observed"], atol=1e-6, rtol=1e-6)
    if recorded["style"] is not None:
        torch.testing.assert_close(style_state(state, view.ground_height), recorded["style"], atol=1e-6, rtol=1e-6)
    before, alive = recorded["terms"], recorded["alive"]
    before["action_energy"] = before.pop("reflex_energy")
    del before["sideways_speed"]  # a term that is gone
    assert before.keys() == task.rewards.keys() and alive.sum() >= 3
    task.rewards["action_energy"].parameters["velocity_scale"] = 0.1
    if "pattern_tracking" in before:
        task.rewards["pattern_tracking"].parameters["bound"] = 5.0
    for term, values in before.items():
        torch.testing.assert_close(task.rewards[term](view)[alive], values[alive], atol=1e-5, rtol=1e-5)
