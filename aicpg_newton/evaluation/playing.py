"""Play a controller: in a live viewer, into a recording or a filmstrip, and always into a table."""

from __future__ import annotations

import contextlib
import io
import math
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch

from aicpg_newton import checkpoint, humanoid
from aicpg_newton.cpg import CONTROL_DT, CONTROL_RATE, DEFAULT_PATTERN, PatternNetwork
from aicpg_newton.device import resolve_device
from aicpg_newton.engines import make_engine
from aicpg_newton.environment import Environment
from aicpg_newton.errors import UserError
from aicpg_newton.evaluation.rollout import Agent, Frame, Tally, kinematic_frames, physical_frames, share_out
from aicpg_newton.learning.runner import Runner
from aicpg_newton.task import Task, task_from_dict
from aicpg_newton.viewing import FilmstripRow, LiveViewer, Recorder, save_filmstrip
from aicpg_newton.viewing.filmstrip import POSES
from aicpg_newton.viewing.output import writable_path


@dataclass(kw_only=True)
class PlayOptions:
    """What to play and where to see it."""

    checkpoint: Path | None = None
    """Trained reflex network: a model_*.pt or a run folder; the one that ships for flat ground when not given."""
    frequency: tuple[float, ...] = (0.9, 1.1, 1.3)
    """Stride frequencies f [Hz]; the environments are shared out evenly among them."""
    num_envs: int = 12
    """Number of environments."""
    duration: float = 10.0
    """Simulated time [s]."""
    agent: Literal["policy", "zero", "random", "mocap"] = "policy"
    """policy: the trained network; zero: the CPG alone; random: noise on the CPG; mocap: the gait without physics."""
    viewer: Literal["viser", "gl", "rerun", "usd", "none"] = "none"
    """Live viewer; usd writes play.usd."""
    record: Path | None = None
    """Write an mp4 of the first environment."""
    filmstrip: Path | None = None
    """Write a PNG of one stride per frequency, in eight poses."""
    device: str = "auto"
    """auto, cpu or cuda:N."""
    engine: str = "auto"
    """newton, mujoco, or auto: newton on CUDA and mujoco on a CPU."""
    seed: int = 0
    """Seed of start states and of the random agent."""


def play(options: PlayOptions, default_task: Task) -> Tally:
    """Let the agent move, show it, and print speed, falls and episode length per frequency.

    Args:
        options: What to play and where to see it.
        default_task: Physics and falls for agents without a checkpoint.

    Raises:
        UserError: An option cannot be met.
    """
    steps = _check(options)
    device = resolve_device(options.device)
    path = options.checkpoint
    if path is None and options.agent == "policy":
        path = checkpoint.shipped(default_task.name)
    trained = None if path is None else checkpoint.read(path)
    if trained is None:
        task, pattern = default_task, PatternNetwork.load(DEFAULT_PATTERN)
    else:
        task = task_from_dict(trained["task"], str(path))
        pattern = PatternNetwork.from_content(trained["pattern"], str(path))
    frequency = torch.tensor(options.frequency)[share_out(options.num_envs, len(options.frequency))].to(device)
    tally = Tally(frequency)
    if options.agent == "mocap":
        frames = kinematic_frames(pattern.to(device), frequency, steps, tally)
    else:
        task.termination.episode_steps = steps + 1
        motors = humanoid.motors()
        engine = make_engine(options.engine, options.num_envs, device, motors, task.physics)
        environment = Environment(task, engine, pattern, motors, seed=options.seed)
        environment.frequency = frequency
        environment.reset(torch.ones(options.num_envs, dtype=torch.bool, device=device))
        frames = physical_frames(environment, _agent(options, environment, trained), steps, tally)
    rows = _show(options, frames, tally)
    if options.filmstrip is not None:
        missing = [label for label, row in rows.items() if row is None]
        complete = [row for row in rows.values() if row is not None]
        if missing:
            print(
                f"No whole stride without a fall within --duration at {', '.join(missing)}: left out of the filmstrip."
            )
        if complete:
            save_filmstrip(options.filmstrip, complete)
            print(f"Filmstrip: {options.filmstrip}")
    if options.record is not None:
        print(f"Recording: {options.record}")
    print(tally.table())
    return tally


def _check(options: PlayOptions) -> int:
    """Number of control steps, once all options make sense."""
    if options.num_envs < len(options.frequency) or not options.frequency:
        raise UserError(
            f"--num-envs is {options.num_envs} for {len(options.frequency)} frequencies; give at least one each"
        )
    if not all(math.isfinite(f) and f > 0 for f in options.frequency):
        raise UserError(f"--frequency is {options.frequency}; give positive numbers in Hz")
    if not (math.isfinite(options.duration) and options.duration >= CONTROL_DT):
        raise UserError(f"--duration is {options.duration}; give a positive number of seconds")
    if options.filmstrip is not None:
        writable_path(options.filmstrip, ".png")
    return round(options.duration * CONTROL_RATE)


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


def load_policy(environment: Environment, trained: dict) -> Agent:
    """The deterministic reflex network of a checkpoint.

    Args:
        environment: The environment it will control, with the checkpoint's task.
        trained: What :func:`checkpoint.read` returned.
    """
    with contextlib.redirect_stdout(io.StringIO()):  # rsl_rl prints the layers of every network it makes
        runner = Runner(environment, trained["run"])
    runner.restore(trained, play_only=True)
    policy = runner.policy()
    return lambda observed: policy({"policy": observed})


def _show(options: PlayOptions, frames: Iterator[Frame], tally: Tally) -> dict[str, FilmstripRow | None]:
    """Run through the frames, showing and recording them; returns a filmstrip row per frequency."""
    first = {f"{f:.2f} Hz": int((tally.frequency == f).nonzero()[0]) for f in tally.frequency.unique().tolist()}
    stride = {label: math.ceil(CONTROL_RATE / float(tally.frequency[env])) for label, env in first.items()}
    kept: dict[str, deque[tuple[int, float, Frame]]] = {}
    strips: dict[str, FilmstripRow | None] = dict.fromkeys(first)
    with ExitStack() as stack:
        viewer = stack.enter_context(LiveViewer(options.viewer, options.num_envs, Path("play.usd")))
        recorder = None if options.record is None else stack.enter_context(Recorder(options.record))
        for step, frame in enumerate(frames, start=1):
            if not viewer.is_running():
                break
            time = step * CONTROL_DT
            viewer.show(frame.root_position, frame.root_rotation, frame.joint_position, time)
            if recorder is not None:
                caption = f"f = {float(tally.frequency[0]):.2f} Hz   {_speed(tally, 0):.2f} m/s   t = {time:.1f} s"
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
