"""What went wrong in a training is logged, said, and can be stepped again; nothing is learned from it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from aicpg_newton.bad_states import BadStatesOptions, show
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.faults import CAUSES
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import ImitationTask, Task
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning import bad_states
from aicpg_newton.learning.amp import AdversarialMotionPriors
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.runner import Runner
from aicpg_newton.learning.training import train


def small_task(method: str = "ai-cpg") -> Task:
    """The flat task with little learning."""
    task = get_task("flat", method)
    task.learning.hidden_sizes = (16, 16)
    task.learning.minibatches = task.learning.epochs = 1
    if isinstance(task, ImitationTask):
        task.imitation.discriminator_hidden_sizes, task.imitation.discriminator_batch = (16, 8), 8
    return task


@pytest.mark.parametrize("engine", ["mujoco", "newton"])
def test_bad_states_are_written_and_step_again(engine: str, tmp_path: Path, capsys: pytest.CaptureFixture):
    """Pushes of 1e7 N: counts in the log, a sentence, and files whose steps go wrong in the same way once more."""
    task = small_task()
    task.pushes.force, task.physics.max_contacts = 1e7, 200  # enough for four at once, and for one alone
    task.pushes.interval = task.pushes.duration = 0.1
    options = RunOptions(num_envs=4, device="cpu", engine=engine, max_iterations=2, run_dir=tmp_path / "run")
    options.dump_bad_states = True
    train(task, options)
    said = capsys.readouterr().out
    assert said.count("Simulations that went wrong and were reset:") == 2 and "unstable" not in said
    log = EventAccumulator(str(tmp_path / "run")).Reload()
    counts = [[event.value for event in log.Scalars(f"Faults/{cause}")] for cause in CAUSES]
    assert all(len(each) == 2 for each in counts) and sum(map(sum, counts)) > 4
    files = sorted((tmp_path / "run").glob("bad_states_*.pt"))
    assert [path.name for path in files] == ["bad_states_0.pt", "bad_states_1.pt"]
    for path in files:
        content = bad_states.read(path)
        then = [CAUSES[cause - 1] for cause in content["robots"]["cause"].tolist()]
        assert content["robots"]["action"].shape == (len(then), 28) and content["engine"] == engine
        again, now = bad_states.step_again(content, str(path))
        assert now == then
        content["robots"]["push"] *= 0
        _, harmless = bad_states.step_again(content, str(path))
        assert harmless == [""] * len(then)
        show(BadStatesOptions(file=path))
        assert f"robot {content['robots']['robot'][0]}: " in capsys.readouterr().out
        assert len(again.state.root_position) == len(then)


def test_no_more_than_so_many_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A run that always goes wrong does not fill the disk."""
    monkeypatch.setattr(bad_states, "MOST", 3)
    task = small_task()
    task.pushes.force, task.pushes.interval, task.pushes.duration = 1e7, 0.1, 0.1
    options = RunOptions(num_envs=4, device="cpu", engine="mujoco", max_iterations=3, run_dir=tmp_path / "run")
    options.dump_bad_states = True
    train(task, options)
    files = [bad_states.read(path) for path in (tmp_path / "run").glob("bad_states_*.pt")]
    assert sum(len(each["robots"]["cause"]) for each in files) == 3


def test_other_files_are_refused(tmp_path: Path):
    """Missing, torn, or something else."""
    torn, other = tmp_path / "torn.pt", tmp_path / "other.pt"
    torn.write_bytes(b"PK")
    torch.save({"format": 1}, other)
    for path, message in ((tmp_path / "none.pt", "no file at"), (torn, "cut short"), (other, "holds no bad states")):
        with pytest.raises(UserError, match=message):
            show(BadStatesOptions(file=path))


@pytest.mark.parametrize("method", ["ai-cpg", "amp"])
def test_nothing_is_learned_from_what_went_wrong(method: str, pattern: PatternNetwork):
    """Robot 1 is thrown at 1e5 m/s, and put 1e5 m up, every few steps: no normaliser, reward or motion has seen it."""
    task = small_task(method)
    environment = Environment(task, engine_for(task, "mujoco", 6, "cpu"), pattern)
    engine = environment.engine
    take_step, done = engine.step, 0

    def step(*command: torch.Tensor, push: torch.Tensor | None) -> None:
        nonlocal done
        snapshot, done = engine.snapshot(), done + 1
        if done % 3 == 0:
            column = 3 if done % 2 else 1 + 7 + 28
            snapshot["rows"][1, column] = 1e5
            engine.restore(snapshot)
        take_step(*command, push=push)

    engine.step = step  # type: ignore[method-assign]
    runner = Runner(environment, {"seed": 0})
    earned: list[float] = []
    process = runner.alg.process_env_step

    def spied(obs, rewards, dones, extras) -> None:
        earned.append(rewards[1].item())
        process(obs, rewards, dones, extras)

    runner.alg.process_env_step = spied
    counts: dict[str, int] = {}
    take = environment.faults.take
    environment.faults.take = lambda: counts.update(take()) or counts  # type: ignore[method-assign]
    runner.learn(1)
    assert counts["too_fast"] + counts["not_finite"] >= 2 and counts["too_high"] >= 2
    assert earned.count(0.0) >= 4
    normaliser: Any = runner.alg.actor.obs_normalizer
    assert normaliser.mean.abs().max() < 50.0 and normaliser.std.max() < 50.0
    if isinstance(runner.alg, AdversarialMotionPriors):
        assert 0 < len(runner.alg.replay.pairs) < 6 * 16 - 4
        assert runner.alg.replay.pairs.abs().max() < 100.0
        assert runner.alg.discriminator.normaliser.std.max() < 50.0
