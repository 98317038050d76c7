"""What a training looks like to whoever watches it: at every checkpoint, how a few robots walk and run.

They are other robots than those that learn, on a CPU, deterministic and undisturbed, and draw no random numbers of the
training's.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from PIL import Image
from tensorboard.compat.proto.summary_pb2 import Summary  # pyright: ignore[reportAttributeAccessIssue] - made by protoc
from tensordict import TensorDict
from torch.utils.tensorboard import SummaryWriter

from aicpg_newton.env.methods import get_method
from aicpg_newton.env.task import Task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning.trial import FREQUENCIES, Trial
from aicpg_newton.robot.humanoid import CONTROL_RATE
from aicpg_newton.viewing.video import FRAME_RATE, VideoWriter

ROBOTS = 8
"""Robots of each gait."""

DURATION = 4.0
"""Simulated time [s]."""

_WIDTH, _HEIGHT = 256, 144
"""Size of a film [px]."""

_FILMED = round(3.0 * CONTROL_RATE)
"""Control steps of a film: a terrain takes far longer to draw than a plane."""


class Demonstration:
    """Lets a few robots show what has been learned.

    Args:
        task: What is learned.
        pattern: The pattern network S.
        folder: Where films go: ``films/<iteration>_<frequency>.mp4``.
    """

    def __init__(self, task: Task, pattern: PatternNetwork, folder: Path) -> None:
        self._trial = Trial(task, "mujoco", pattern, torch.device("cpu"), robots=ROBOTS, duration=DURATION)
        self._folder = folder / "films"
        self._follows_frequency = get_method(task.method).follows_frequency

    def __call__(self, decide: Callable[[TensorDict], torch.Tensor]) -> dict[str, float]:
        """Let them walk and run.

        Args:
            decide: The policy: from observations to actions, shape [num_envs, 28].

        Returns:
            For each gait the share of robots that never fell, their mean speed [m/s] and the share of the time in
            which no foot is on the ground, the last two over the robots' first episodes; by name.
        """
        self._outcomes, flights = [], []
        for outcome in self._trial.outcomes(decide):
            self._outcomes.append(outcome)
            flights.append(self._trial.measures().flight)
        outcomes, flight = self._outcomes, torch.stack(flights)
        standing = torch.stack([~(outcome.fallen | outcome.off_course) for outcome in outcomes]).cumprod(dim=0).bool()
        speed = torch.stack([outcome.state.root_linear_velocity[:, 0] for outcome in outcomes])
        measures: dict[str, float] = {}
        for group, frequency in enumerate(FREQUENCIES if self._follows_frequency else (math.nan,)):
            mine = slice(group * ROBOTS, (group + 1) * ROBOTS) if self._follows_frequency else slice(None)
            counted = standing[:, mine]
            name = f"Demonstration/{self._title(frequency)}"
            measures[f"{name}_stand"] = float(counted[-1].float().mean())
            measures[f"{name}_speed"] = float(speed[:, mine][counted].mean())
            measures[f"{name}_flight"] = float(flight[:, mine][counted].mean())
        return measures

    def _title(self, frequency: float) -> str:
        return f"{frequency}_Hz" if self._follows_frequency else "all"

    def film(self, iteration: int) -> list[Path]:
        """Film the first robot of each gait, or of all, in the last demonstration, after so many iterations."""
        self._folder.mkdir(exist_ok=True)
        films = []
        for group, frequency in enumerate(FREQUENCIES if self._follows_frequency else (math.nan,)):
            robot = slice(group * ROBOTS, group * ROBOTS + 1)
            path = self._folder / f"{iteration:06d}_{self._title(frequency)}.mp4"
            with VideoWriter(path, terrain=self._trial.terrain, width=_WIDTH, height=_HEIGHT) as video:
                for step, outcome in enumerate(self._outcomes[:_FILMED], start=1):
                    state = outcome.state
                    caption = f"{self._title(frequency).replace('_', ' ')}, {step / CONTROL_RATE:.0f} s"
                    position, rotation = state.root_position[robot], state.root_rotation[robot]
                    video.add(position, rotation, state.joint_position[robot], caption)
            films.append(path)
        return films


def as_gif(film: Path) -> bytes:
    """A film as an animated GIF of every third frame, which TensorBoard can show."""
    import imageio_ffmpeg  # here, as a machine that only trains may be without an encoder

    frames = imageio_ffmpeg.read_frames(str(film))
    size = next(frames)["size"]
    pictures = [Image.frombytes("RGB", size, frame) for frame in list(frames)[::3]]
    content = io.BytesIO()
    pause = round(3000 / FRAME_RATE)
    pictures[0].save(content, "GIF", save_all=True, append_images=pictures[1:], duration=pause, loop=0)
    return content.getvalue()


def log_film(writer: SummaryWriter, film: Path, iteration: int) -> None:
    """Put a film into TensorBoard's images, under its gait's name."""
    name = f"Demonstration/{film.stem.partition('_')[2]}"
    image = Summary.Image(encoded_image_string=as_gif(film))
    summary = Summary(value=[Summary.Value(tag=name, image=image)])
    file: Any = writer._get_file_writer()
    file.add_summary(summary, iteration)
