"""What moves when something is played: a trained network, the CPG alone, noise on it, or the imitated gait."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import torch

from aicpg_newton.device import resolve_device
from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.env.methods import condition, get_method, on_task
from aicpg_newton.env.registry import TASKS, get_task
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import DEFAULT_PATTERN, PatternNetwork
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.policy import Agent, Trained, load_policy
from aicpg_newton.playing.attended import Attended
from aicpg_newton.playing.options import FREQUENCIES, PlayOptions
from aicpg_newton.playing.rollout import Frame, Tally, kinematic_frames, no_action, physical_frames, share_out
from aicpg_newton.viewing.desk import Desk
from aicpg_newton.viewing.kinds import LIVE_KINDS

if TYPE_CHECKING:
    from aicpg_newton.env.environment import Environment

_TERRAIN_SEED = 1000

_TURN_MARGIN = 0.1
"""How far a desk lets the stride frequency go beyond those of the training [Hz]."""


@dataclass
class Basis:
    """What all agents move on."""

    task: Task
    """Ground, falls and, of a trained network, its own settings."""
    pattern: PatternNetwork
    """The pattern network S."""
    content: dict[str, Any] | None
    """Content of the checkpoint; None where none is played."""

    @classmethod
    def of(cls, options: PlayOptions, task: Task) -> Basis:
        """What the options name.

        Args:
            options: What to play.
            task: The task that ``options.task`` names; if it names none, that of agents without a checkpoint.

        Raises:
            UserError: A checkpoint cannot be read, or there is no terrain to have a seed.
        """
        path, own_ground = options.checkpoint, options.task is None
        if path is None and options.agent == "policy":
            path, own_ground = checkpoint.best_for(task.name), False
        if path is None:
            return cls(_on_ground(task, options.terrain_seed), PatternNetwork.load(DEFAULT_PATTERN), None)
        trained = Trained.read(path)
        own = trained.task if own_ground else on_task(trained.task, task)
        return cls(_on_ground(own, options.terrain_seed), trained.pattern, trained.content)


@dataclass
class Motion:
    """Something that moves."""

    frames: Iterator[Frame]
    """Poses, one control step after the other."""
    tally: Tally
    """What they count in."""
    own_terrain: Terrain | None = None
    """The ground to begin on; None for a plane."""
    title: str = ""
    """What is shown in place of a frequency that does nothing."""
    desk: Desk | None = None
    """Where whoever watches asks for something."""
    attended: Attended | None = None
    """The roll-out that obeys it."""
    first: dict[str, int] = field(init=False)
    """First robot of each group, by the group's name."""

    def __post_init__(self) -> None:
        frequencies = self.tally.frequency
        self.first = {
            self.title or f"{f:.2f} Hz": int((frequencies == f).nonzero()[0]) for f in frequencies.unique().tolist()
        }

    @property
    def terrain(self) -> Terrain | None:
        """The ground that the robots are on; None for a plane."""
        return self.own_terrain if self.attended is None else self.attended.terrain

    @property
    def turned(self) -> bool:
        """Whether somebody has turned a stride frequency by hand."""
        return self.attended is not None and self.attended.turned


def policy(options: PlayOptions, basis: Basis, steps: int) -> Motion:
    """A trained network, deterministic."""
    assert basis.content is not None
    content = basis.content
    return _physical(options, basis, steps, lambda environment: load_policy(environment, content))


def zero(options: PlayOptions, basis: Basis, steps: int) -> Motion:
    """The CPG without its reflexes."""
    return _physical(options, basis, steps, lambda environment: no_action)


def random(options: PlayOptions, basis: Basis, steps: int) -> Motion:
    """Noise in place of the reflexes, as large as an untrained network's."""
    spread = basis.task.learning.initial_std

    def agent(environment: Environment) -> Agent:
        generator = torch.Generator(device=environment.device).manual_seed(options.seed)
        shape = (environment.num_envs, environment.num_actions)
        return lambda observed: spread * torch.randn(shape, generator=generator, device=observed.device)

    return _physical(options, basis, steps, agent)


def mocap(options: PlayOptions, basis: Basis, steps: int) -> Motion:
    """The imitated gait on a plane, without physics."""
    if basis.task.ground.uneven:
        print("The imitated gait is played back without physics, so it walks on a plane.")
    device = resolve_device(options.device)
    tally = Tally(_shared_out(options.frequency or FREQUENCIES, options.robots).to(device))
    return Motion(kinematic_frames(basis.pattern.to(device), tally.frequency, steps, tally), tally)


SOURCES = {"policy": policy, "zero": zero, "random": random, "mocap": mocap}
"""What can be played: a function of the options, of what they stand on and of the number of control steps."""


def _physical(options: PlayOptions, basis: Basis, steps: int, agent_of: Callable[[Environment], Agent]) -> Motion:
    """Robots that an agent controls.

    Raises:
        UserError: The options cannot be met on this task.
    """
    method = get_method(basis.task.method)
    title = "" if method.follows_frequency else f"{method.title} {condition(basis.task)}"
    if title and options.frequency:
        raise UserError(f"--frequency does nothing to a network trained as {title}; leave it out")
    # Of a network that no frequency sets it is the clock of the filmstrip alone.
    frequencies = _shared_out((1.0,) if title else options.frequency or FREQUENCIES, options.robots)
    device = resolve_device(options.device)
    tally = Tally(frequencies.to(device), follows_frequency=not title)
    grounds = {_name_of(basis.task.ground): basis.task}

    def begin(ground: str) -> tuple[Environment, Agent]:
        from aicpg_newton.env.environment import Environment, engine_for  # here: seconds to load, options may be wrong

        task = grounds[ground].undisturbed()
        task = replace(task, termination=replace(task.termination, episode_steps=steps + 1))
        engine = engine_for(task, options.engine, len(frequencies), device)
        environment = Environment(task, engine, basis.pattern, seed=options.seed)
        environment.restart(tally.frequency)
        return environment, agent_of(environment)

    if options.viewer not in LIVE_KINDS:
        environment, agent = begin(*grounds)
        return Motion(physical_frames(environment, agent, steps, tally), tally, environment.engine.terrain, title)
    if options.record is None:  # a recording stays on its ground
        others = (on_task(basis.task, get_task(name)) for name in TASKS)
        grounds |= {_name_of(task.ground): _on_ground(task, None) for task in others}
    trained = basis.task.frequencies
    desk = Desk(
        frequencies=[] if title else frequencies.tolist(),
        lowest=round(trained.minimum - _TURN_MARGIN, 2),
        highest=round(trained.maximum + _TURN_MARGIN, 2),
        grounds=tuple(grounds) if len(grounds) > 1 else (),
        ground=_name_of(basis.task.ground),
        num_robots=len(frequencies),
    )
    attended = Attended(desk, tally, begin)
    return Motion(attended.frames(steps), tally, title=title, desk=desk, attended=attended)


def _name_of(ground: Ground) -> str:
    """What a ground is called on a desk."""
    return f"uneven, {100 * ground.height_range:.0f} cm" if ground.uneven else "flat"


def _on_ground(task: Task, terrain_seed: int | None) -> Task:
    """The task on ground of another seed, with its full heights everywhere: levels are for training."""
    if task.ground.uneven:
        return replace(task, ground=task.ground.unseen(_TERRAIN_SEED if terrain_seed is None else terrain_seed))
    if terrain_seed is not None:
        raise UserError(
            f"--terrain-seed is {terrain_seed}, but the ground of task {task.name!r} is a plane;"
            " give --task uneven or leave the seed out"
        )
    return task


def _shared_out(frequencies: tuple[float, ...], num_envs: int) -> torch.Tensor:
    """Stride frequency of each robot [Hz], shape [num_envs]."""
    if num_envs < len(frequencies):
        raise UserError(f"--num-envs is {num_envs} for {len(frequencies)} frequencies; give at least one each")
    return torch.tensor(frequencies)[share_out(num_envs, len(frequencies))]
