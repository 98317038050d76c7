"""What happens to a training's process: killed at any moment, or on a full disk."""

from __future__ import annotations

import contextlib
import functools
import os
import random
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.learning import checkpoint, resuming, work
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.runner import Runner
from aicpg_newton.learning.training import train

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")

INTERVAL = 3
"""Iterations between checkpoints."""


def small_task() -> Task:
    """An iteration of it takes some milliseconds without physics."""
    task = get_task("flat")
    learning = task.learning
    learning.hidden_sizes, learning.steps_per_iteration = (64, 64), 2
    learning.minibatches = learning.epochs = 1
    learning.save_interval = INTERVAL
    return task


def in_a_fresh_interpreter(test: Callable[..., None]) -> Callable[..., None]:
    """Run a test in a process that has no threads yet: what others hold while this one forks stays locked for ever."""

    @functools.wraps(test)
    def wrapped(*args: Any, **fixtures: Any) -> None:
        if "IN_A_FRESH_INTERPRETER" in os.environ:
            return test(*args, **fixtures)
        name = os.environ["PYTEST_CURRENT_TEST"].rpartition(" (")[0]
        command = [sys.executable, "-m", "pytest", "-q", "-s", "-n", "0", "-m", "slow or not slow", name]
        environment = {**os.environ, "IN_A_FRESH_INTERPRETER": "1"}
        root = Path(__file__).parents[2]
        done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]

    return wrapped


def in_a_process(work: Callable[[], object], errors: Path | None = None) -> int:
    """Number of a new process that does the work: a fork, as importing torch takes seconds."""
    process = os.fork()
    if process:
        return process
    code = 1
    try:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
        sys.stderr = open(errors or os.devnull, "w", encoding="utf-8")  # noqa: SIM115
        run_command(work)
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    finally:
        with contextlib.suppress(Exception):
            sys.stderr.flush()
        os._exit(code)


def run_for_ever(folder: Path, engine: str, report: int) -> None:
    """Begin a run or resume it, and report each iteration that is done and each save that begins."""
    log, save = Runner._tell_of_faults, resuming.write

    def told(self: Runner, iteration: int) -> None:
        os.write(report, f"{iteration + 1}\n".encode())
        log(self, iteration)

    def saving(runner: Runner, model: Path) -> None:
        os.write(report, b"save\n")
        save(runner, model)

    Runner._tell_of_faults, resuming.write = told, saving
    begun = folder.exists()
    options = RunOptions(num_envs=6, device="cpu", engine=engine, max_iterations=10**6)
    options.run_dir, options.resume = (None, folder) if begun else (folder, None)
    train(small_task(), options)


def kill_at_random(folder: Path, engine: str, within_a_save: bool, dice: random.Random) -> int:
    """Let it run for a while and kill it; the result is the number of iterations that were done."""
    read, write = os.pipe()
    process = in_a_process(lambda: run_for_ever(folder, engine, write))
    os.close(write)
    told, deadline = "", time.monotonic() + 120.0
    saves_to_come = 2 + dice.randrange(3)
    while told.count("save") < saves_to_come:
        assert select.select([read], [], [], max(0.0, deadline - time.monotonic()))[0], "it does not go on"
        more = os.read(read, 4096).decode()
        assert more, "it has ended by itself"
        told += more
    time.sleep(dice.random() * (0.006 if within_a_save else 0.15))
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    while more := os.read(read, 4096).decode():
        told += more
    os.close(read)
    return int(next(line for line in reversed(told.split("\n")[:-1]) if line != "save"))


@in_a_fresh_interpreter
def test_whatever_kills_it_loses_no_more_than_an_interval(puppet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Five times kill -9, three of them within a save."""
    killed_again_and_again(5, "auto", puppet, tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize(("kills", "engine"), [(44, "auto"), (6, "mujoco")])
@in_a_fresh_interpreter
def test_fifty_kills(kills: int, engine: str, puppet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Without physics, for which a process is quickly made, and some with."""
    killed_again_and_again(kills, engine, puppet, tmp_path, monkeypatch)


def killed_again_and_again(kills: int, engine: str, puppet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin a run, and kill and resume it; each time all is there but for an interval, and goes on exactly."""
    if engine == "auto":
        monkeypatch.setattr(work, "engine_for", lambda task, name, num_envs, device: puppet(num_envs))
    folder, dice, torn = tmp_path / "run", random.Random(7), 0
    before = 0
    for kill in range(kills):
        done = kill_at_random(folder, engine, kill % 2 == 0, dice)
        found = checkpoint.find(folder)
        assert found.skipped == [] and found.content["iteration"] >= done - INTERVAL and done > before
        state = torch.load(resuming.beside(found.path), weights_only=True)
        assert state["iteration"] == found.content["iteration"]
        torn += any(path.suffix == ".partial" for path in folder.iterdir())
        before = found.content["iteration"]
    print(f"{kills} kills, {torn} of them within a write; {before} iterations are left")
    assert torn or kills < 10
    options = RunOptions(num_envs=6, device="cpu", engine=engine, max_iterations=before + 1, resume=folder)
    train(small_task(), options)
    assert not list(folder.glob("*.partial"))


@pytest.mark.parametrize(
    ("room", "sentence"),
    [
        (1_000, r"cannot write .*config_from_iteration_2\.yaml"),
        (4_000, r"cannot write .*state_3\.pt"),
        (60_000, r"cannot write .*model_3\.pt"),
    ],
)
@in_a_fresh_interpreter
def test_a_full_disk_is_one_sentence(room: int, sentence: str, puppet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """At the first file that does not fit; the last checkpoint and its state are as they were."""
    monkeypatch.setattr(work, "engine_for", lambda task, name, num_envs, device: puppet(num_envs))
    folder, said = tmp_path / "run", tmp_path / "said"
    options = RunOptions(num_envs=6, device="cpu", max_iterations=2, run_dir=folder)
    train(small_task(), options)
    kept = {path.name: path.read_bytes() for path in folder.glob("*.pt")}
    assert kept.keys() == {"model_0.pt", "model_1.pt", "state_1.pt"}

    def go_on() -> None:
        resource: Any = pytest.importorskip("resource")
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))  # stands for a full disk or quota
        train(small_task(), RunOptions(device="cpu", max_iterations=50, resume=folder))

    _, status = os.waitpid(in_a_process(go_on, said), 0)
    assert os.waitstatus_to_exitcode(status) == 2, said.read_text(encoding="utf-8")
    lines = [line for line in said.read_text(encoding="utf-8").splitlines() if "Warp" not in line]
    assert len(lines) == 1
    with pytest.raises(UserError, match=sentence):
        raise UserError(lines[0])
    assert {path.name: path.read_bytes() for path in folder.glob("*.pt")} == kept
    assert not list(folder.glob("*.partial"))
    resumed = train(small_task(), RunOptions(device="cpu", max_iterations=4, resume=folder))
    assert checkpoint.read(resumed)["iteration"] == 4


@in_a_fresh_interpreter
def test_nobody_resumes_a_run_that_goes_on(puppet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """While it trains its folder is locked; once it is killed it is not."""
    monkeypatch.setattr(work, "engine_for", lambda task, name, num_envs, device: puppet(num_envs))
    folder = tmp_path / "run"
    read, write = os.pipe()
    process = in_a_process(lambda: run_for_ever(folder, "auto", write))
    os.close(write)
    told = ""
    while told.count("save") < 2:
        told += os.read(read, 4096).decode()
    last = checkpoint.find(folder).content["iteration"]
    options = RunOptions(num_envs=6, device="cpu", max_iterations=last + 1000, resume=folder)
    try:
        with pytest.raises(UserError, match="another process trains in"):
            train(small_task(), options)
    finally:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        os.close(read)
    options.max_iterations = checkpoint.find(folder).content["iteration"] + 1
    train(small_task(), options)
