"""A replayed step of the Newton engine is the same, bit for bit, as one whose kernels are launched one by one."""

import time

import pytest
import torch

from aicpg_newton.engines import make_engine
from aicpg_newton.engines.newton import NewtonEngine
from aicpg_newton.engines.terrain import Ground
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.registry import get_task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.robot import humanoid

NUM_ENVS = 8


@pytest.mark.parametrize(
    "ground", [Ground(), Ground(height_range=0.1, length=24.0, width=16.0)], ids=["plane", "terrain"]
)
def test_captured_steps_are_the_uncaptured_ones(pattern: PatternNetwork, ground: Ground):
    """Walking, falling, being reset and pushed; and replaying takes less time."""
    seen, seconds = [], []
    for capture in (True, False):
        task = get_task("flat")
        task.ground, task.physics.capture, task.pushes.force = ground, capture, 200.0
        engine = make_engine("newton", NUM_ENVS, "cpu", humanoid.motors(), task.physics, ground)
        assert isinstance(engine, NewtonEngine) and (engine._step_graph is not None) == capture
        environment = Environment(task, engine, pattern, seed=2)
        generator = torch.Generator().manual_seed(3)
        environment.step(torch.zeros(NUM_ENVS, 28))
        began, steps = time.perf_counter(), []
        for _ in range(45):
            observed, reward, dones, _ = environment.step(0.5 * torch.randn(NUM_ENVS, 28, generator=generator))
            steps.append(torch.cat((observed["policy"], reward.unsqueeze(1), dones.unsqueeze(1)), dim=1))
        seconds.append(time.perf_counter() - began)
        seen.append(torch.stack(steps))
        assert engine.overflows() == 0 and engine.high_water()["constraints"] > 0
    assert torch.equal(seen[0], seen[1])
    assert 2 < seen[0][..., -1].sum() < 45 * NUM_ENVS
    assert seconds[0] < seconds[1]


def test_a_new_engine_has_not_moved(pattern: PatternNetwork):
    """Recording a step leaves nothing behind: no motion, no force, no full buffers."""
    ends = []
    for capture in (True, False):
        physics = get_task("flat").physics
        physics.capture = capture
        engine = make_engine("newton", 2, "cpu", humanoid.motors(), physics)
        assert isinstance(engine, NewtonEngine)
        assert engine.overflows() == 0 and engine.high_water() == {"constraints": 0, "contacts": 0.0}
        ends.append(vars(engine.state))
    assert all(torch.equal(ends[0][name], ends[1][name]) for name in ends[0])
