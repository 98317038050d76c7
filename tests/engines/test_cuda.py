"""The captured graph on a GPU does what plain launches on the CPU do."""

from dataclasses import fields
from pathlib import Path

import pytest
import torch

from aicpg_newton.engines import BodyState, Physics, make_engine
from aicpg_newton.engines.terrain import Ground
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.registry import get_task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.training import train
from aicpg_newton.robot import humanoid

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")


@pytest.mark.parametrize(
    ("ground", "tolerance"),
    [(Ground(), 2e-3), (Ground(height_range=0.1, length=16.0, width=8.0), 2e-2)],
    ids=["plane", "terrain"],
)
def test_walking_on_a_gpu_is_walking_on_the_cpu(pattern: PatternNetwork, ground: Ground, tolerance: float):
    """From the same start, eight steps of CPG, reflex and push end in the same state.

    On terrain, which of nearly equal contact points are kept depends on the order in which a GPU finds them.
    """
    ends = []
    actions = 0.3 * torch.randn(8, 16, 28, generator=torch.Generator().manual_seed(0))
    still = make_engine("mujoco", 16, "cpu", humanoid.motors(), Physics(), ground)
    start = Environment(get_task("flat"), still, pattern)
    initial = {field.name: getattr(still.state, field.name) for field in fields(BodyState)}
    for device in ("cpu", "cuda:0"):
        motors = humanoid.motors().to(device)
        engine = make_engine("newton", 16, device, motors, Physics(), ground)
        everyone = torch.ones(16, dtype=torch.bool, device=device)
        engine.reset(everyone, BodyState(**{name: value.to(device) for name, value in initial.items()}))
        for action in actions:
            target, rate = (
                value.to(device) for value in pattern.to("cpu").target(start.phase, start.commands.frequency)
            )
            push = torch.tensor([100.0, 50.0, 0.0], device=device).repeat(16, 1)
            engine.step(target, rate, 10.0 * action.to(device), push=push)
        assert engine.overflows() == 0
        ends.append({name: value.cpu() for name, value in vars(engine.state).items()})
    for name, value in ends[0].items():
        scale = max(1.0, value.abs().max().item())
        median = (ends[1][name] - value).abs().flatten(1).amax(dim=1).median()
        assert median < tolerance * scale, name


@pytest.mark.parametrize("task", ["flat", "uneven"])
def test_training_on_a_gpu(tmp_path: Path, task: str):
    """A short run ends with a checkpoint."""
    last = train(get_task(task), RunOptions(num_envs=64, device="cuda:0", max_iterations=2, run_dir=tmp_path / "run"))
    assert last.is_file()
