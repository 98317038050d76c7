"""What moves when something is played: a trained network, the CPG alone, noise on it, or the imitated gait."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import torch

from aicpg_newton.device import resolve_device
from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.methods import condition, get_method, on_task
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import DEFAULT_PATTERN, PatternNetwork
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.policy import Agent, Trained, load_policy
from aicpg_newton.playing.options import PlayOptions
from aicpg_newton.playing.rollout import Frame, Tally, kinematic_frames, no_action, physical_frames, share_out
from aicpg_newton.robot.humanoid import CONTROL_DT
from aicpg_newton.viewing import Slider

FREQUENCIES = (0.9, 1.1, 1.3)
"""Stride frequencies when none is given [Hz]."""

_TERRAIN_SEED = 1000

_TURN_RATE = 0.25
"""How fast the stride frequency follows the slider [Hz/s]; at 0.5 robots fell when it was turned from 1.35 to 0.85."""

_TURN_MARGIN = 0.1
"""How far the slider goes beyond the frequencies of the training [Hz]."""


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
    terrain: Terrain | None = None
    """The ground; None for a plane."""
    title: str = ""
    """What is shown in place of a frequency that does nothing."""
    slider: Slider | None = None
    """Stride frequency of all robots, for whoever watches."""
    first: dict[str, int] = field(init=False)
    """First robot of each group, by the group's name."""

    def __post_init__(self) -> None:
        frequencies = self.tally.frequency
        self.first = {
            self.title or f"{f:.2f} Hz": int((frequencies == f).nonzero()[0]) for f in frequencies.unique().tolist()
        }


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
    tally = Tally(_shared_out(options.frequency or FREQUENCIES, options.num_envs).to(device))
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
    frequencies = _shared_out((1.0,) if title else options.frequency or FREQUENCIES, options.num_envs)
    task = basis.task.undisturbed()
    task = replace(task, termination=replace(task.termination, episode_steps=steps + 1))
    device = resolve_device(options.device)
    engine = engine_for(task, options.engine, options.num_envs, device)
    environment = Environment(task, engine, basis.pattern, seed=options.seed)
    tally = Tally(frequencies.to(device), follows_frequency=not title)
    environment.restart(tally.frequency)
    frames = physical_frames(environment, agent_of(environment), steps, tally)
    if title:
        return Motion(frames, tally, engine.terrain, title)
    slider = slider_for(environment)
    return Motion(turned(frames, environment, slider), tally, engine.terrain, slider=slider)


def slider_for(environment: Environment) -> Slider:
    """A slider that stands at the first robot's frequency."""
    trained = environment.task.frequencies
    return Slider(
        label="f [Hz]",
        value=round(float(environment.commands.frequency[0]), 2),
        minimum=round(trained.minimum - _TURN_MARGIN, 2),
        maximum=round(trained.maximum + _TURN_MARGIN, 2),
    )


def turned(frames: Iterator[Frame], environment: Environment, slider: Slider) -> Iterator[Frame]:
    """The frames of robots whose frequency goes where the slider stands, once somebody has moved it."""
    most = _TURN_RATE * CONTROL_DT
    for frame in frames:
        yield frame
        if slider.moved:
            now = environment.commands.frequency
            environment.command(frequency=now + (slider.value - now).clamp(-most, most))


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
