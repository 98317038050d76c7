"""The work of a training: from a simulation and a learner to checkpoints."""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any

import torch
import yaml

from aicpg_newton import places
from aicpg_newton.device import worth_compiling
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.faults import BadStates
from aicpg_newton.env.methods import run_name
from aicpg_newton.env.registry import task_from_dict
from aicpg_newton.env.stored import plain, to_dict
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from aicpg_newton.files import write_text
from aicpg_newton.learning import checkpoint, distributed, resuming
from aicpg_newton.learning.bookkeeping import CONFIG_NAME, git_revision, store_changes
from aicpg_newton.learning.demonstration import Demonstration
from aicpg_newton.learning.plan import Plan, RunOptions
from aicpg_newton.learning.runner import Runner, TimeIsUp
from aicpg_newton.robot.fingerprint import fingerprint

_SEEDS_APART = 1_000_003
"""Between the seeds of two processes; no run has as many iterations."""


def train_in(folder: Path, task: Task, options: RunOptions, plan: Plan) -> Path:
    """Train in a folder that is this run's own; the first process alone writes into it."""
    previous = None if plan.found is None else plan.found.content
    start, rank, processes = plan.start, distributed.rank(), distributed.size()
    done = 0 if previous is None else previous["iteration"]
    begun = {"seed": options.seed or 0} if previous is None else previous["run"]
    origin = begun.get("start_from")
    if start is not None and options.start_from is not None:
        origin = f"{places.portable(options.start_from)} ({start['samples']} samples)"
    # A resumed run does not draw the same numbers again, and no process those of another.
    seed = begun["seed"] + done + rank * _SEEDS_APART
    torch.manual_seed(seed)
    print("Building the simulation; the first time on a machine, compiling its kernels can take two minutes.")
    engine = engine_for(task, options.engine, plan.num_envs, plan.device)
    compiled = worth_compiling(options.compile, plan.device)
    environment = Environment(task, engine, plan.pattern, seed=seed, rank=rank, processes=processes, compiled=compiled)
    if options.dump_bad_states and rank == 0:
        environment.bad_states = BadStates(plan.num_envs, environment.device)
    number = f"{plan.num_envs} environments" + (f" in each of {processes} processes" if processes > 1 else "")
    print(f"Task {run_name(task)}: {number}, engine {engine.name}, device {plan.device}. Folder: {folder}")
    revision, reason = git_revision()
    if reason:
        print(f"The revision of the code is not known ({reason}); the run goes on without.")
    run = {
        "num_envs": plan.num_envs,
        "processes": processes,
        "engine": engine.name,
        "device": _title(plan.device),
        "learner_device": _title(plan.learner_device),
        "seed": begun["seed"],
        "max_iterations": options.max_iterations,
        "start_from": origin,
        "git_revision": revision,
        "versions": {name: metadata.version(name) for name in ("newton", "warp-lang", "mujoco", "torch", "rsl-rl-lib")},
    }
    seconds = math.inf if options.max_minutes is None else 60 * options.max_minutes
    own = folder if rank == 0 else None
    runner = Runner(environment, run, own, seconds, plan.learner_device, logger=options.logger)
    if options.demonstrate and rank == 0:
        runner.demonstration, runner.film_every = Demonstration(task, plan.pattern, folder), options.film_every
    if start is not None:
        runner.take_networks(start, "actor", "critic")
        runner.obey(task.learning, task_from_dict(start["task"], str(options.start_from)).learning)
        print(f"Begins with the networks of {options.start_from}.")
    if previous is not None:
        runner.restore(previous)
        runner.obey(task.learning, task_from_dict(previous["task"], str(options.resume)).learning)
    if rank == 0:
        _write_records(folder, environment.task, run, done)
    resume = f"{places.command('train')} --resume {folder}"
    exact = plan.found is not None and _resumed(runner, plan.found)
    try:
        with signals_that_interrupt(runner.stop_together if processes > 1 else runner.stop_soon):
            runner.learn(options.max_iterations - done, init_at_random_ep_len=not exact)
    except TimeIsUp:
        print(f"The {options.max_minutes:g} minutes are over; continue with:  {resume}")
    except KeyboardInterrupt:
        _keep(runner, folder, resume)
        raise
    except RuntimeError as error:
        if not distributed.is_loss(error):
            raise
        _keep(runner, folder, resume)
        raise UserError(
            "another process of this training has ended or does not answer any more; what it said stands above, and"
            f" --resume {folder} goes on"
        ) from error
    if rank > 0:
        return folder
    last = checkpoint.find(folder).path
    overflows = engine.overflows()
    if overflows:
        print(f"Contact or constraint buffers overflowed in {overflows} environments; raise physics.max-contacts.")
    print(
        f"Done: {last}\nSee it:  {places.command('play')} --checkpoint {last}\nCurves:  tensorboard --logdir {folder}"
    )
    return last


def _write_records(folder: Path, task: Task, run: dict[str, Any], done: int) -> None:
    """Settings and uncommitted code, of a new run or of the part of one that begins after so many iterations."""
    name = CONFIG_NAME if not (folder / CONFIG_NAME).exists() else f"config_from_iteration_{done}.yaml"
    _write_config(folder / name, task, run)
    store_changes(folder)


def _keep(runner: Runner, folder: Path, resume: str) -> None:
    """Save the iterations of a run that ends early, and say what goes on with them."""
    if distributed.rank() > 0:
        return
    path = folder / f"model_{runner.current_learning_iteration}.pt"
    if runner.has_learned and not resuming.beside(path).is_file():  # in the middle of an iteration
        runner.save_networks(str(path))
    if any(folder.glob("model_*.pt")):
        print(f"\nStopped; continue with:  {resume}")


def _resumed(runner: Runner, found: checkpoint.Found) -> bool:
    """Go on exactly where a checkpoint was written, if that can be, and say so."""
    reason = resuming.restore(runner, found.path)
    begins = "" if not reason else f"; robots, episodes and random numbers begin anew, as {reason}"
    print(f"Resumed {found.path} after {found.content['iteration']} iterations{begins}.")
    return not reason


@contextmanager
def signals_that_interrupt(stop: Callable[[], None] | None = None) -> Iterator[None]:
    """SIGTERM (a cluster's time is up) and SIGHUP (a terminal is closed) end a run as Ctrl-C does: it saves first.

    Args:
        stop: What these three call, where the run cannot just be left, as others wait for it; it may be called often.
    """

    def interrupt(number: int, frame: object) -> None:
        if stop is None:
            raise KeyboardInterrupt
        stop()

    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may ask for signals
        return
    wanted = ("SIGTERM", "SIGHUP") if stop is None else ("SIGTERM", "SIGHUP", "SIGINT")
    names = [name for name in wanted if hasattr(signal, name)]
    before = {name: signal.signal(getattr(signal, name), interrupt) for name in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)


def _title(device: torch.device) -> str:
    """Name of a device in the records of a run."""
    return torch.cuda.get_device_name(device) if device.type == "cuda" else device.type


def _write_config(path: Path, task: Task, run: dict[str, Any]) -> None:
    """Every setting as it was used."""
    content = {"run": run, "humanoid": fingerprint(), "task": plain(to_dict(task))}
    write_text(path, yaml.safe_dump(content, sort_keys=False))
