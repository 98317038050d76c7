"""What a training will do: its options, found good before anything slow is loaded or written."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

import torch

from aicpg_newton.device import Compile, resolve_device, resolve_learner_device
from aicpg_newton.engines import engine_name
from aicpg_newton.env.registry import task_from_dict
from aicpg_newton.env.task import ReflexTask, Task
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import DEFAULT_PATTERN, PatternNetwork
from aicpg_newton.learning import checkpoint
from aicpg_newton.ranges import AT_LEAST_ONE, ENVIRONMENTS, POSITIVE, SEED, Range, check_ranges


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
class Plan:
    """A run whose options have been found good."""

    device: torch.device
    learner_device: torch.device
    pattern: PatternNetwork
    num_envs: int
    found: checkpoint.Found | None
    """The checkpoint that is continued."""
    start: dict[str, Any] | None
    """Content of the checkpoint whose networks a new run begins with."""


def plan_of(task: Task, options: RunOptions) -> Plan:
    """Look at all options.

    Raises:
        UserError: One cannot be met.
    """
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
    return Plan(device, learner_device, pattern, num_envs, found, start)


def with_networks_of(task: Task, start_from: Path) -> Task:
    """A task whose networks are built as those of a checkpoint, to begin a new run with them.

    The scale of the reward is the checkpoint's too: its critic's values are in units of it. So is what an action does
    (:class:`~aicpg_newton.env.task.Reflex`), where both have a reflex.

    Raises:
        UserError: The checkpoint cannot be read, or is of another version.
    """
    own = task_of(start_from)
    names = ("network", "hidden_sizes", "critic_hidden_sizes", "activation", "reward_scale")
    learning = replace(task.learning, **{name: getattr(own.learning, name) for name in names})
    if isinstance(task, ReflexTask) and isinstance(own, ReflexTask):
        return replace(task, learning=learning, reflex=own.reflex)
    return replace(task, learning=learning)


def task_of(resume: Path) -> Task:
    """The task a checkpoint was trained on.

    Raises:
        UserError: The checkpoint cannot be read, or is of another version.
    """
    return task_from_dict(checkpoint.find(resume).content["task"], str(resume))
