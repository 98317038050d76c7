"""One training run from settings to checkpoints."""

from __future__ import annotations

import math
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import dataclass, replace
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
import yaml

from aicpg_newton import places
from aicpg_newton.device import Compile, resolve_device, resolve_learner_device, worth_compiling
from aicpg_newton.engines import engine_name
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.faults import BadStates
from aicpg_newton.env.methods import run_name
from aicpg_newton.env.registry import task_from_dict
from aicpg_newton.env.stored import plain, to_dict
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from aicpg_newton.files import only_one, write_text
from aicpg_newton.gait.cpg import DEFAULT_PATTERN, PatternNetwork
from aicpg_newton.learning import checkpoint, distributed, resuming
from aicpg_newton.learning.bookkeeping import RUNNING, claim, git_revision, new_folder, release, store_changes
from aicpg_newton.learning.demonstration import Demonstration
from aicpg_newton.learning.runner import Runner, TimeIsUp
from aicpg_newton.ranges import AT_LEAST_ONE, ENVIRONMENTS, POSITIVE, SEED, Range, check_ranges
from aicpg_newton.robot.fingerprint import fingerprint

CONFIG_NAME = "config.yaml"
_SEEDS_APART = 1_000_003
"""Between the seeds of two processes; no run has as many iterations."""


@dataclass(kw_only=True)
class RunOptions:
    """How and where to train, apart from the task."""

    num_envs: Annotated[int | None, ENVIRONMENTS] = None
    """Number of environments, of each process where torchrun starts several; 8192 on CUDA and 256 on a CPU when not
    given."""
    device: str = "auto"
    """auto, cpu or cuda:N; of several processes each takes its own GPU."""
    engine: str = "auto"
    """newton, mujoco, or auto: newton on CUDA and mujoco on a CPU."""
    learner_device: str | None = None
    """Device of the networks beside physics on the CPU (engine mujoco): cuda:N or mps."""
    max_iterations: Annotated[int, AT_LEAST_ONE] = 3000
    """Iterations of the whole run, those before a resume included (paper, Sec. III-A: 3000 epochs)."""
    max_minutes: Annotated[float | None, POSITIVE] = None
    """Stop at the first checkpoint after this time [min]; --resume goes on from there."""
    seed: Annotated[int | None, SEED] = None
    """Seed of networks, exploration and resets, 0 when not given; a resumed run keeps its own."""
    run_dir: Path | None = None
    """Folder of the run; runs/<task>/<method>/<date and time> when not given."""
    pattern: Path | None = None
    """Weights of the pattern network, from python -m aicpg_newton.motion; those that ship when not given."""
    resume: Path | None = None
    """Checkpoint or run folder to continue, in the same folder unless --run-dir is given."""
    start_from: Path | None = None
    """Checkpoint or run folder whose networks and pattern a new run begins with, as assets/policies/flat.pt."""
    logger: Literal["tensorboard", "wandb", "none"] = "tensorboard"
    """Where curves go: TensorBoard files in the run folder, Weights & Biases too (pip install wandb), or nowhere."""
    demonstrate: bool = True
    """At every checkpoint let 16 other robots walk and run on a CPU for 4 s: curves of who stands, speed and flight."""
    film_every: Annotated[int, Range(0, 1_000_000)] = 5
    """Film a walk and a run at every so many of these checkpoints, into films/ in the run folder; 0 never."""
    compile: Compile = "auto"
    """Make a few kernels of what stands around the physics, with a compiler, in a minute or two; auto: on a GPU."""
    dump_bad_states: bool = False
    """Write what a simulation that goes wrong began from into the run folder: bad_states_<iteration>.pt, at most 256
    robots. Every step is copied for that."""


@dataclass
class _Plan:
    """A run whose options have been found good."""

    device: torch.device
    learner_device: torch.device
    pattern: PatternNetwork
    num_envs: int
    found: checkpoint.Found | None
    """The checkpoint that is continued."""
    start: dict[str, Any] | None
    """Content of the checkpoint whose networks a new run begins with."""


def train(task: Task, options: RunOptions) -> Path:
    """Train the reflex network until ``max_iterations`` are done; with the other processes of a launcher, if any.

    Args:
        task: What is to be learned.
        options: How and where.

    Returns:
        The last checkpoint; in any but the first of several processes the run's folder, as they write nothing.

    Raises:
        UserError: An option cannot be met; nothing has been written then.
    """
    with distributed.joined(), redirect_stdout(None if distributed.rank() else sys.stdout):
        plan = distributed.together(lambda: _plan(task, options))
        folder = distributed.from_first(lambda: _run_folder(task, options))
        try:
            return _alone_in(folder, lambda: _train_in(folder, task, options, plan))
        finally:
            if distributed.rank() == 0:
                release(folder)


def _alone_in(folder: Path, work: Callable[[], Path]) -> Path:
    """Work in a run folder for as long as no other training does; of several processes the first one looks.

    Raises:
        UserError: Another training does.
    """
    with only_one(folder / RUNNING) if distributed.rank() == 0 else nullcontext(True) as alone:

        def look() -> None:
            if not alone:
                raise UserError(f"another process trains in {folder} at this moment; stop it first, or wait for it")

        distributed.together(look)
        for partial in folder.glob("*.pt.partial") if distributed.rank() == 0 else ():
            partial.unlink(missing_ok=True)  # of a process that was killed in the middle of a save
        return work()


def _plan(task: Task, options: RunOptions) -> _Plan:
    """Look at all options before anything slow."""
    task.validate()
    check_ranges(options, "--")
    on_cpu = options.engine == "mujoco" and options.device == "auto"  # it runs nowhere else
    device = torch.device("cpu") if on_cpu else resolve_device(options.device)
    learner_device = resolve_learner_device(options.learner_device, engine_name(options.engine, device), device)
    if options.logger == "wandb" and find_spec("wandb") is None:
        raise UserError("--logger wandb needs a package that is not installed; run: pip install wandb")
    if options.resume is not None and options.start_from is not None:
        raise UserError("--resume continues a run and --start-from begins a new one; give one of them")
    found = None if options.resume is None else checkpoint.find(options.resume)
    previous = None if found is None else found.content
    for sentence in () if found is None else found.skipped:
        print(sentence)
    start = None if options.start_from is None else checkpoint.read(options.start_from)
    if previous is not None:
        checkpoint.require_run(previous, options.resume or Path())
    if previous is not None and "optimizer_state_dict" not in previous["algorithm"]:
        raise UserError(
            f"{options.resume} holds no optimiser, it can only be played; resume from a run's own checkpoint"
        )
    if previous is not None and options.seed not in (None, previous["run"]["seed"]):
        raise UserError(
            f"--seed is {options.seed}, but {options.resume} is a run of seed {previous['run']['seed']}; leave it out,"
            " or begin a new run with --start-from"
        )
    if previous is not None and previous["iteration"] >= options.max_iterations:
        raise UserError(
            f"{options.resume} has {previous['iteration']} iterations already; give a larger --max-iterations"
        )
    known = previous or start
    if known is not None and options.pattern is not None:
        raise UserError(
            f"--pattern {options.pattern} goes with a new run; {options.resume or options.start_from} brings the"
            " pattern network that its networks were trained with, so leave it out"
        )
    if known is None:
        pattern = PatternNetwork.load(options.pattern or DEFAULT_PATTERN)
    else:
        pattern = PatternNetwork.from_content(known["pattern"], str(options.resume or options.start_from))
    num_envs = options.num_envs or (8192 if device.type == "cuda" else 256)
    if options.num_envs is None and previous is not None:
        num_envs = previous["run"]["num_envs"]
    samples = num_envs * task.learning.steps_per_iteration
    if samples < task.learning.minibatches:
        raise UserError(f"{samples} samples do not fill learning.minibatches = {task.learning.minibatches}; lower it")
    return _Plan(device, learner_device, pattern, num_envs, found, start)


def _train_in(folder: Path, task: Task, options: RunOptions, plan: _Plan) -> Path:
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


def with_networks_of(task: Task, start_from: Path) -> Task:
    """A task whose networks are built as those of a checkpoint, to begin a new run with them.

    The scale of the reward is the checkpoint's too: its critic's values are in units of it.

    Raises:
        UserError: The checkpoint cannot be read, or is of another version.
    """
    own = task_of(start_from)
    names = ("network", "hidden_sizes", "critic_hidden_sizes", "activation", "reward_scale")
    return replace(task, learning=replace(task.learning, **{name: getattr(own.learning, name) for name in names}))


def task_of(resume: Path) -> Task:
    """The task a checkpoint was trained on.

    Raises:
        UserError: The checkpoint cannot be read, or is of another version.
    """
    return task_from_dict(checkpoint.find(resume).content["task"], str(resume))


def _run_folder(task: Task, options: RunOptions) -> Path:
    """Where the run goes; a folder that holds another run is never written into."""
    if options.run_dir is None and options.resume is not None:
        folder = options.resume if options.resume.is_dir() else options.resume.parent
        last = checkpoint.find(folder).path
        if options.resume.is_file() and last.name != options.resume.name:
            raise UserError(f"{folder} holds later checkpoints up to {last.name}; resume that one, or give --run-dir")
        return folder
    if options.run_dir is None:
        return new_folder(Path("runs") / task.name / task.method)
    claim(options.run_dir)
    return options.run_dir


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
