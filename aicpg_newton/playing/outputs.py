"""Where a played motion goes: a live viewer, a recording, a filmstrip."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import torch

from aicpg_newton.errors import UserError
from aicpg_newton.playing.options import PlayOptions
from aicpg_newton.playing.rollout import Frame, Tally
from aicpg_newton.playing.sources import Motion
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE
from aicpg_newton.viewing.filmstrip import POSES, FilmstripRow, save_filmstrip
from aicpg_newton.viewing.kinds import LIVE_KINDS
from aicpg_newton.viewing.live import LiveViewer
from aicpg_newton.viewing.video import VideoWriter


class Output(Protocol):
    """One of them."""

    def take(self, frame: Frame, step: int) -> bool:
        """Show a frame after so many control steps; False once nobody looks any more."""
        ...

    def finish(self) -> None:
        """The motion is over: complete what was begun and say where it is."""
        ...


@contextlib.contextmanager
def outputs_of(options: PlayOptions, motion: Motion) -> Iterator[list[Output]]:
    """The outputs that the options ask for; what is left by an exception leaves no half files.

    Raises:
        UserError: A viewer or a file cannot be opened.
    """
    with contextlib.ExitStack() as stack:
        robots = len(motion.tally.frequency)
        viewer = LiveViewer(options.viewer, robots, Path("play.usd"), motion.terrain, motion.desk)
        opened: list[Output] = [Screen(stack.enter_context(viewer), motion)]
        if options.record is not None:
            video = stack.enter_context(VideoWriter(options.record, terrain=motion.terrain))
            opened.append(Film(video, motion, options.record))
        if options.filmstrip is not None:
            opened.append(Filmstrip(motion, options.filmstrip))
        if options.viewer in LIVE_KINDS:
            stack.enter_context(contextlib.suppress(KeyboardInterrupt))  # the way to leave a live viewer
        yield opened
    for output in opened:
        output.finish()


class Screen:
    """A live viewer, or the one that shows nothing."""

    def __init__(self, viewer: LiveViewer, motion: Motion) -> None:
        self._viewer, self._motion, self._terrain = viewer, motion, motion.terrain

    def take(self, frame: Frame, step: int) -> bool:
        """See :meth:`Output.take`."""
        if self._motion.terrain is not self._terrain:
            self._terrain = self._motion.terrain
            self._viewer.stand_on(self._terrain)
        pose = frame.root_position, frame.root_rotation, frame.joint_position
        self._viewer.show(*pose, step * CONTROL_DT, frame.readings)
        return self._viewer.is_running()

    def finish(self) -> None:
        """Nothing: the viewer is closed by whoever opened it."""


class Film:
    """A recording of the first robot, with its frequency, speed and time in the picture."""

    def __init__(self, video: VideoWriter, motion: Motion, path: Path) -> None:
        self._video, self._title, self._tally, self._path = video, motion.title, motion.tally, path

    def take(self, frame: Frame, step: int) -> bool:
        """See :meth:`Output.take`."""
        name = self._title or f"f = {float(frame.frequency[0]):.2f} Hz"
        caption = f"{name}   {self._tally.speed(0):.2f} m/s   t = {step * CONTROL_DT:.1f} s"
        self._video.add(frame.root_position[:1], frame.root_rotation[:1], frame.joint_position[:1], caption)
        return True

    def finish(self) -> None:
        """See :meth:`Output.finish`."""
        print(f"Recording: {self._path}")


class Filmstrip:
    """The last whole stride of the first robot of each group that begins at phase 0 and lies in one episode."""

    def __init__(self, motion: Motion, path: Path) -> None:
        self._path, self._terrain, self._tally = path, motion.terrain, motion.tally
        self._strides = {
            label: _Stride(label, env, self._tally, math.ceil(CONTROL_RATE / float(self._tally.frequency[env])))
            for label, env in motion.first.items()
        }

    def take(self, frame: Frame, step: int) -> bool:
        """See :meth:`Output.take`."""
        for stride in self._strides.values():
            stride.take(frame)
        return True

    def finish(self) -> None:
        """See :meth:`Output.finish`."""
        missing = [label for label, stride in self._strides.items() if stride.row is None]
        complete = [stride.row for stride in self._strides.values() if stride.row is not None]
        if missing and complete:
            print(
                f"No whole stride without a fall within --duration at {', '.join(missing)}: left out of the filmstrip."
            )
        if not complete:
            raise UserError(
                f"no filmstrip to write to {self._path}: no robot did a whole stride; give a longer --duration"
            )
        save_filmstrip(self._path, complete, self._terrain)
        print(f"Filmstrip: {self._path}")


class _Stride:
    """Looks for whole strides of one robot."""

    def __init__(self, label: str, env: int, tally: Tally, steps: int) -> None:
        self._label, self._env, self._tally, self._steps = label, env, tally, steps
        self._window: deque[Frame] = deque(maxlen=steps)
        self.row: FilmstripRow | None = None

    def take(self, frame: Frame) -> None:
        """Look at the next frame."""
        env, window = self._env, self._window
        window.append(frame)
        whole = len(window) == self._steps and int(window[0].episode[env]) == int(window[-1].episode[env])
        if whole and float(window[0].phase[env]) < 2 * math.pi / (self._steps - 1):
            poses = [window[round(pose * self._steps / POSES)] for pose in range(POSES)]
            self.row = FilmstripRow(
                f"{self._label}\n{self._tally.speed(env):.2f} m/s",
                torch.stack([pose.root_position[env] for pose in poses]),
                torch.stack([pose.root_rotation[env] for pose in poses]),
                torch.stack([pose.joint_position[env] for pose in poses]),
            )
