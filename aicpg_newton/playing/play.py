"""Play a controller: in a live viewer, into a recording or a filmstrip, and always into a table."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import torch

from aicpg_newton.device import resolve_device
from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.methods import condition, get_method, on_task
from aicpg_newton.env.task import Task, task_from_dict
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import DEFAULT_PATTERN, PatternNetwork
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.policy import Agent, load_policy
from aicpg_newton.playing.rollout import Frame, Tally, kinematic_frames, physical_frames, share_out
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE
from aicpg_newton.viewing import LIVE_KINDS, FilmstripRow, LiveViewer, Recorder, Slider, save_filmstrip
from aicpg_newton.viewing.filmstrip import POSES
from aicpg_newton.viewing.output import writable_path


@dataclass(kw_only=True)
class PlayOptions:
    """What to play and where to see it."""

    checkpoint: Path | None = None
    """Trained network: a model_*.pt or a run folder; the one that ships for the task when not given."""
    task: str | None = None
    """Task to play on, flat or uneven; by default the checkpoint's own, and flat without a checkpoint."""
    terrain_seed: int | None = None
    """Seed of uneven ground; 1000 when not given, which no training takes by itself."""
    frequency: tuple[float, ...] = ()
    """Stride frequencies f [Hz], 0.9, 1.1 and 1.3 when not given; the environments are shared out evenly among them."""
    num_envs: int = 12
    """Number of environments."""
    duration: float | None = None
    """Simulated time [s]; when not given 10, and in a live viewer an hour, which Ctrl-C ends."""
    agent: Literal["policy", "zero", "random", "mocap"] = "policy"
    """policy: the trained network; zero: the CPG alone; random: noise on it; mocap: the gait on a plane, no physics."""
    viewer: Literal["viser", "gl", "rerun", "usd", "none"] = "none"
    """Live viewer; viser and gl have a slider for the stride frequency of all robots; usd writes play.usd."""
    record: Path | None = None
    """Write an mp4 of the first environment."""
    filmstrip: Path | None = None
    """Write a PNG of one stride per frequency, in eight poses; of one second where no frequency sets the stride."""
    device: str = "auto"
    """auto, cpu or cuda:N."""
    engine: str = "auto"
    """newton, mujoco, or auto: newton on CUDA and mujoco on a CPU."""
    seed: int = 0
    """Seed of start states and of the random agent."""


_FREQUENCIES = (0.9, 1.1, 1.3)
_TERRAIN_SEED = 1000

_DURATION, _LIVE_DURATION = 10.0, 3600.0
"""Simulated time when none is given [s]."""

_TURN_RATE = 0.25
"""How fast the stride frequency follows the slider [Hz/s]; at 0.5 robots fell when it was turned from 1.35 to 0.85."""

_TURN_MARGIN = 0.1
"""How far the slider goes beyond the frequencies of the training [Hz]."""


def play(options: PlayOptions, task: Task) -> Tally:
    """Let the agent move, show it, and print speed, falls and episode length per frequency.

    Args:
        options: What to play and where to see it.
        task: The task that ``options.task`` names; if it names none, that of agents without a checkpoint.

    Raises:
        UserError: An option cannot be met.
    """
    steps = _check(options)
    device = resolve_device(options.device)
    path = options.checkpoint
    if path is None and options.agent == "policy":
        path = checkpoint.shipped(task.name)
    trained = None if path is None else checkpoint.read(path)
    if trained is None:
        pattern = PatternNetwork.load(DEFAULT_PATTERN)
    else:
        own = task_from_dict(trained["task"], str(path))
        task = own if options.task is None else on_task(own, task)
        pattern = PatternNetwork.from_content(trained["pattern"], str(path))
    task = replace(task, ground=_ground(options, task), termination=replace(task.termination, episode_steps=steps + 1))
    mocap = options.agent == "mocap"
    frequency, title = _conditions(options, None if mocap else task)
    tally = Tally(frequency.to(device), follows_frequency=not title)
    terrain = slider = None
    if mocap:
        if task.ground.uneven:
            print("The imitated gait is played back without physics, so it walks on a plane.")
        frames = kinematic_frames(pattern.to(device), tally.frequency, steps, tally)
    else:
        engine = engine_for(task, options.engine, options.num_envs, device)
        terrain = engine.terrain
        environment = Environment(task, engine, pattern, seed=options.seed)
        environment.restart(tally.frequency)
        frames = physical_frames(environment, _agent(options, environment, trained), steps, tally)
        if tally.follows_frequency:
            slider = _slider(environment)
            frames = _turned(frames, environment, slider)
    rows = _show(options, frames, tally, terrain, title, slider)
    if options.filmstrip is not None:
        missing = [label for label, row in rows.items() if row is None]
        complete = [row for row in rows.values() if row is not None]
        if missing:
            print(
                f"No whole stride without a fall within --duration at {', '.join(missing)}: left out of the filmstrip."
            )
        if complete:
            save_filmstrip(options.filmstrip, complete, terrain)
            print(f"Filmstrip: {options.filmstrip}")
    if options.record is not None:
        print(f"Recording: {options.record}")
    if slider is not None and slider.moved:
        print("The stride frequency was turned by hand; f in the table is what it was at the start.")
    print(tally.table())
    return tally


def _slider(environment: Environment) -> Slider:
    """A slider that stands at the first robot's frequency."""
    trained = environment.task.frequencies
    return Slider(
        label="f [Hz]",
        value=round(float(environment.frequency[0]), 2),
        minimum=round(trained.minimum - _TURN_MARGIN, 2),
        maximum=round(trained.maximum + _TURN_MARGIN, 2),
    )


def _turned(frames: Iterator[Frame], environment: Environment, slider: Slider) -> Iterator[Frame]:
    """The frames of robots whose frequency goes where the slider stands, once somebody has moved it."""
    most = _TURN_RATE * CONTROL_DT
    for frame in frames:
        yield frame
        if slider.moved:
            environment.frequency = environment.frequency + (slider.value - environment.frequency).clamp(-most, most)


def _check(options: PlayOptions) -> int:
    """Number of control steps, once all options make sense."""
    if not all(math.isfinite(f) and f > 0 for f in options.frequency):
        raise UserError(f"--frequency is {options.frequency}; give positive numbers in Hz")
    duration = options.duration
    if duration is None:
        watched = options.viewer in LIVE_KINDS and options.record is None and options.filmstrip is None
        duration = _LIVE_DURATION if watched else _DURATION
    if not (math.isfinite(duration) and duration >= CONTROL_DT):
        raise UserError(f"--duration is {duration}; give a positive number of seconds")
    if options.filmstrip is not None:
        writable_path(options.filmstrip, ".png")
    return round(duration * CONTROL_RATE)


def _ground(options: PlayOptions, task: Task) -> Ground:
    """The task's ground with the seed asked for, and its full heights everywhere: levels are for training."""
    if not task.ground.uneven:
        if options.terrain_seed is not None:
            raise UserError(
                f"--terrain-seed is {options.terrain_seed}, but the ground of task {task.name!r} is a plane;"
                " give --task uneven or leave the seed out"
            )
        return task.ground
    return task.ground.unseen(_TERRAIN_SEED if options.terrain_seed is None else options.terrain_seed)


def _conditions(options: PlayOptions, task: Task | None) -> tuple[torch.Tensor, str]:
    """Stride frequency of each environment, shape [num_envs], and the title of a network that it means nothing to.

    Args:
        options: What to play.
        task: The task that is played; None for the imitated gait, which follows the frequency.
    """
    frequencies, title = options.frequency or _FREQUENCIES, ""
    if task is not None and not get_method(task.method).follows_frequency:
        title = f"{get_method(task.method).title} {condition(task)}"
        if options.frequency:
            raise UserError(f"--frequency does nothing to a network trained as {title}; leave it out")
        frequencies = (1.0,)  # the clock of such a network's filmstrip alone
    if options.num_envs < len(frequencies):
        raise UserError(f"--num-envs is {options.num_envs} for {len(frequencies)} frequencies; give at least one each")
    return torch.tensor(frequencies)[share_out(options.num_envs, len(frequencies))], title


def _agent(options: PlayOptions, environment: Environment, trained: dict | None) -> Agent:
    """What turns observations into actions."""
    shape = (environment.num_envs, environment.num_actions)
    if options.agent == "policy":
        assert trained is not None
        return load_policy(environment, trained)
    if options.agent == "zero":
        return lambda observed: observed.new_zeros(shape)
    generator = torch.Generator(device=environment.device).manual_seed(options.seed)
    spread = environment.task.learning.initial_std
    return lambda observed: spread * torch.randn(shape, generator=generator, device=observed.device)


def _show(
    options: PlayOptions,
    frames: Iterator[Frame],
    tally: Tally,
    terrain: Terrain | None,
    title: str,
    slider: Slider | None,
) -> dict[str, FilmstripRow | None]:
    """Run through the frames, showing and recording them; returns a filmstrip row per frequency.

    Args:
        options: Where to see it.
        frames: Poses, one control step after the other.
        tally: What they count in.
        terrain: Shape of the ground; None for a plane.
        title: What is shown in place of a frequency, if any.
        slider: What a live viewer lets its user change.
    """
    first = {
        title or f"{f:.2f} Hz": int((tally.frequency == f).nonzero()[0]) for f in tally.frequency.unique().tolist()
    }
    stride = {label: math.ceil(CONTROL_RATE / float(tally.frequency[env])) for label, env in first.items()}
    kept: dict[str, deque[tuple[int, float, Frame]]] = {}
    strips: dict[str, FilmstripRow | None] = dict.fromkeys(first)
    with ExitStack() as stack:
        viewer = stack.enter_context(LiveViewer(options.viewer, options.num_envs, Path("play.usd"), terrain, slider))
        recorder = None if options.record is None else stack.enter_context(Recorder(options.record, terrain=terrain))
        if options.viewer in LIVE_KINDS:
            stack.enter_context(contextlib.suppress(KeyboardInterrupt))
        for step, frame in enumerate(frames, start=1):
            if not viewer.is_running():
                break
            time = step * CONTROL_DT
            viewer.show(frame.root_position, frame.root_rotation, frame.joint_position, time)
            if recorder is not None:
                name = title or f"f = {float(frame.frequency[0]):.2f} Hz"
                caption = f"{name}   {_speed(tally, 0):.2f} m/s   t = {time:.1f} s"
                recorder.add(frame.root_position[:1], frame.root_rotation[:1], frame.joint_position[:1], caption)
            if options.filmstrip is None:
                continue
            for label, env in first.items():
                window = kept.setdefault(label, deque(maxlen=stride[label]))
                window.append((int(frame.episode[env]), float(frame.phase[env]), frame))
                # The last stride that begins at phase 0 and lies in one episode.
                whole = len(window) == stride[label] and window[0][0] == window[-1][0]
                if whole and window[0][1] < 2 * math.pi / (stride[label] - 1):
                    poses = [window[round(pose * stride[label] / POSES)][2] for pose in range(POSES)]
                    strips[label] = FilmstripRow(
                        f"{label}\n{_speed(tally, env):.2f} m/s",
                        torch.stack([pose.root_position[env] for pose in poses]),
                        torch.stack([pose.root_rotation[env] for pose in poses]),
                        torch.stack([pose.joint_position[env] for pose in poses]),
                    )
    return strips


def _speed(tally: Tally, env: int) -> float:
    """Mean speed of an environment so far [m/s]."""
    return float(tally.distance[env]) / (max(tally.steps, 1) * CONTROL_DT)
