"""An interrupted and resumed run is the uninterrupted one, bit for bit; where it cannot be, it says so."""

from __future__ import annotations

import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from rsl_rl.algorithms import PPO
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from aicpg_newton.env.environment import Environment
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import ImitationTask, Task
from aicpg_newton.errors import UserError
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.ppo import BoundedPPO
from aicpg_newton.learning.runner import Runner
from aicpg_newton.learning.training import train

WALL_CLOCK = ("Perf/", "Train/mean_reward/time", "Train/mean_episode_length/time")
"""What is logged of time that passes, or over it."""


def small_task(name: str, method: str = "ai-cpg") -> Task:
    """Little learning with everything that is random: pushes, changes of f, levels, short episodes."""
    task = get_task(name, method)
    learning = task.learning
    learning.hidden_sizes, learning.steps_per_iteration = (32, 32), 10
    learning.minibatches = learning.epochs = 2
    learning.save_interval = 100
    task.termination.episode_steps = 24
    task.pushes.force, task.pushes.interval = 150.0, 0.3
    if isinstance(task, ImitationTask):
        task.imitation.discriminator_hidden_sizes, task.imitation.discriminator_batch = (16, 8), 8
        task.imitation.replay_size = 150
        task.termination.episode_steps = 4  # a time-out is paid by the step before, also over the interruption
    else:
        task.frequencies = replace(task.frequencies, change_interval=0.2, jumps=0.3)
    if task.ground.uneven:
        task.ground = replace(task.ground, levels=3, length=24.0, width=30.0)
    return task


def options(folder: Path | None, **changes: Any) -> RunOptions:
    """Six robots on the CPU."""
    return RunOptions(**{"num_envs": 6, "device": "cpu", "engine": "mujoco", "run_dir": folder, **changes})


def curves(folder: Path) -> dict[str, dict[int, float]]:
    """All that was logged, by iteration, but for times."""
    log = EventAccumulator(str(folder)).Reload()
    tags = [tag for tag in log.Tags()["scalars"] if not tag.startswith(WALL_CLOCK)]
    return {tag: {event.step: event.value for event in log.Scalars(tag)} for tag in tags}


def the_same(one: Any, other: Any) -> bool:
    """Whether nested data agree to the bit."""
    if isinstance(one, torch.Tensor):
        return one.dtype == other.dtype and torch.equal(one, other)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(the_same(one[name], other[name]) for name in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(the_same, one, other))
    return one == other


@pytest.mark.parametrize("engine", ["mujoco", "newton"])
@pytest.mark.parametrize(("name", "method"), [("flat", "ai-cpg"), ("uneven", "ai-cpg"), ("flat", "amp")])
def test_resumed_is_uninterrupted(name: str, method: str, engine: str, tmp_path: Path):
    """Six iterations, and three and then three more: weights, optimiser, logs and the state after it all."""
    task = small_task(name, method)
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    train(task, options(whole, engine=engine, max_iterations=6))
    train(task, options(parts, engine=engine, max_iterations=3))
    train(task, options(None, engine=engine, max_iterations=6, resume=parts, num_envs=None))
    one, other = (checkpoint.read(folder) for folder in (whole, parts))
    assert one["iteration"] == other["iteration"] == 6 and one["samples"] == other["samples"]
    assert the_same(one["algorithm"], other["algorithm"])
    assert curves(whole) == curves(parts) and len(curves(whole)["Learning/rate"]) == 6
    states = [torch.load(folder / "state_5.pt", weights_only=True) for folder in (whole, parts)]
    for state in states:
        state["logger"].pop("seconds")
        state["run"].pop("max_iterations")
    assert the_same(*states)
    assert [path.name for path in parts.glob("state_*")] == ["state_5.pt"]
    if name == "uneven":
        assert states[0]["environment"]["level"].max() > 0


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of three iterations."""
    folder = tmp_path_factory.mktemp("runs") / "first"
    train(small_task("flat"), options(folder, max_iterations=3))
    return folder


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("number", "the number of environments changed"),
        ("engine", "the engine changed"),
        ("task", "settings of termination, pushes changed"),
        ("missing", "there is no state_2.pt beside it"),
        ("torn", "state_2.pt cannot be read"),
        ("other", "state_2.pt is of another version"),
        ("learning", ""),
    ],
)
def test_what_is_not_restored_is_told(what: str, reason: str, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture):
    """In one sentence, and the run goes on; learning may change, as robots do not mind."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    task, changes = small_task("flat"), {}
    if what == "number":
        changes["num_envs"] = 4
    elif what == "engine":
        changes["engine"] = "newton"
    elif what == "task":
        task.pushes.force, task.termination.episode_steps = 10.0, 50
    elif what == "missing":
        (folder / "state_2.pt").unlink()
    elif what == "torn":
        (folder / "state_2.pt").write_bytes((folder / "state_2.pt").read_bytes()[:5000])
    elif what == "other":
        torch.save({"training_state": 99}, folder / "state_2.pt")
    else:
        task.learning.discount = 0.9
    train(task, options(None, resume=folder, max_iterations=4, **changes))
    said = capsys.readouterr().out
    anew = f"; robots, episodes and random numbers begin anew, as {reason}" if reason else ""
    assert f"Resumed {folder / 'model_2.pt'} after 3 iterations{anew}." in said
    assert checkpoint.read(folder)["iteration"] == 4


@pytest.mark.parametrize("change", ["reward", "ground"])
def test_levels_outlive_a_change_of_reward(
    change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    """Robots begin anew, but on the strips that their curriculum had reached; on other ground on the first."""
    folder, level = tmp_path / "run", torch.tensor([0, 2, 1, 0, 1, 2])
    train(small_task("uneven"), options(folder, max_iterations=1))
    state = torch.load(folder / "state_0.pt", weights_only=True)
    state["environment"]["level"] = level
    torch.save(state, folder / "state_0.pt")
    begun: list[Environment] = []
    monkeypatch.setattr(Runner, "learn", lambda runner, *_, **__: begun.append(runner.env))
    task = small_task("uneven")
    if change == "reward":
        task.rewards["survival"].weight = 2.0
    else:
        task.ground.height_range = 0.2
    train(task, options(None, resume=folder, max_iterations=2))
    kept = ", each on the level of the ground that it had reached" if change == "reward" else ""
    settings = "rewards" if change == "reward" else "ground"
    assert f"begin anew, as settings of {settings} changed{kept}.\n" in capsys.readouterr().out
    (environment,) = begun
    assert torch.equal(environment.level, level if change == "reward" else torch.zeros_like(level))
    strip = task.ground.width / task.ground.levels
    y = environment.engine.state.root_position[:, 1] + 0.5 * task.ground.width
    assert torch.equal((y / strip).floor().long(), environment.level)


def test_a_state_of_something_else_is_refused(run: Path, tmp_path: Path):
    """One that says it is of this run and is not: the message says what to do."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    state = torch.load(folder / "state_2.pt", weights_only=True)
    state["environment"]["engine"]["rows"] = torch.zeros(2, 3)
    torch.save(state, folder / "state_2.pt")
    with pytest.raises(UserError, match=r"state_2\.pt does not fit this run; delete it"):
        train(small_task("flat"), options(None, resume=folder, max_iterations=4))


def test_the_newest_whole_checkpoint_is_resumed(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture):
    """Torn and empty ones are skipped, by name; what they stand for is done again."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / "model_3.pt").write_bytes((folder / "model_2.pt").read_bytes()[:-2000])
    (folder / "model_4.pt").write_bytes(b"")
    whole = (folder / "model_2.pt").read_bytes()
    (folder / "model_5.pt").write_bytes(whole[:3000] + bytes(len(whole) - 3000))
    train(small_task("flat"), options(None, resume=folder, max_iterations=4))
    said = capsys.readouterr().out
    assert f"Skipped {folder / 'model_3.pt'}: it cannot be read and may be cut short." in said
    assert f"Skipped {folder / 'model_4.pt'}: it is empty." in said
    assert f"Skipped {folder / 'model_5.pt'}: it cannot be read" in said
    assert f"Resumed {folder / 'model_2.pt'} after 3 iterations." in said
    assert f"Done: {folder / 'model_3.pt'}" in said
    assert checkpoint.find(folder).path.name == "model_3.pt"


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_ends_a_run_where_it_can_go_on_exactly(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """In the middle of the second iteration, which is finished; four iterations in two runs are those of one."""
    task = small_task("flat")
    whole = train(task, options(tmp_path / "whole", max_iterations=4))
    updates = []
    update = BoundedPPO.update

    def interrupted(self: BoundedPPO) -> dict[str, float]:
        updates.append(1)
        if len(updates) == 2:
            os.kill(os.getpid(), getattr(signal, name))
        return update(self)

    monkeypatch.setattr(BoundedPPO, "update", interrupted)
    before = signal.getsignal(getattr(signal, name))
    with pytest.raises(KeyboardInterrupt):
        train(task, options(tmp_path / "parts", max_iterations=4))
    assert signal.getsignal(getattr(signal, name)) == before
    assert checkpoint.read(tmp_path / "parts")["iteration"] == 2
    last = train(task, options(None, resume=tmp_path / "parts", max_iterations=4))
    assert the_same(*(checkpoint.read(path)["algorithm"] for path in (whole, last)))


def test_a_second_signal_ends_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """What has been learned is saved all the same, and a checkpoint that goes with a state is not touched."""
    updates = []
    update = PPO.update

    def interrupted(self: PPO) -> dict[str, float]:
        updates.append(1)
        if len(updates) == 3:
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGTERM)
        return update(self)

    monkeypatch.setattr(PPO, "update", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(small_task("flat"), options(tmp_path / "run", max_iterations=5))
    assert {path.name for path in (tmp_path / "run").glob("*.pt")} == {"model_0.pt", "state_0.pt", "model_1.pt"}
    assert checkpoint.read(tmp_path / "run")["iteration"] == 2
