"""Memory does not grow while a training goes on; SOAK_MINUTES=30 for half an hour on each engine."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from aicpg_newton.env.registry import get_task
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.runner import Runner
from aicpg_newton.learning.training import train

_MEMORY = Path("/proc/self/statm")


@pytest.mark.slow
@pytest.mark.skipif(not _MEMORY.is_file(), reason="this system does not say how much memory a process has")
@pytest.mark.parametrize("engine", ["mujoco", "newton"])
def test_memory_is_flat(engine: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """To 2 % after the first fifth of the time, with falls, faults that are written down, logs and checkpoints."""
    minutes = float(os.environ.get("SOAK_MINUTES", "1"))
    task = get_task("flat")
    task.learning.hidden_sizes, task.learning.save_interval = (64, 64), 20
    task.pushes.force, task.frequencies.change_interval, task.termination.episode_steps = 300.0, 2.0, 100
    memory: list[int] = []
    tell = Runner._tell_of_faults

    def weighed(self: Runner, iteration: int) -> None:
        tell(self, iteration)
        memory.append(int(_MEMORY.read_text(encoding="utf-8").split()[1]) * os.sysconf("SC_PAGE_SIZE"))

    monkeypatch.setattr(Runner, "_tell_of_faults", weighed)
    options = RunOptions(num_envs=8, device="cpu", engine=engine, max_iterations=10**6, max_minutes=minutes)
    options.run_dir, options.dump_bad_states = tmp_path / "run", True
    train(task, options)
    warm = memory[len(memory) // 5 :]
    growth = max(warm) / warm[0] - 1.0
    print(f"{engine}: {len(memory)} iterations, {warm[0] / 2**20:.1f} MB, {max(warm) / 2**20:.1f} MB at most")
    assert len(memory) > 20 and growth < 0.02, f"{100 * growth:.1f} % more after {len(warm)} iterations"
