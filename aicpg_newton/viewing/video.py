"""Recordings: the poses of a simulation as an mp4, with a camera that follows."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from pathlib import Path
from types import TracebackType

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.errors import UserError
from aicpg_newton.files import WholeFile
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import CONTROL_RATE
from aicpg_newton.viewing.camera import Studio, facing
from aicpg_newton.viewing.output import TEXT_COLOUR, writable_path
from aicpg_newton.viewing.stage import Stage, Tracker

FRAME_RATE = 30
"""Frames per second of a recording [Hz]."""

_STEPS_PER_FRAME = round(CONTROL_RATE / FRAME_RATE)
_AZIMUTH, _ELEVATION, _FIELD_OF_VIEW = math.radians(22.0), math.radians(11.0), math.radians(30.0)
_VIEW_HEIGHT = 2.3
"""Height of the picture at the robot [m]."""


class VideoWriter:
    """Writes an H.264 mp4 at 30 frames per second from poses at the control rate of 60 per second.

    The camera looks at the robot's right side, slightly from the front and above, and follows the pelvis; the ground is
    a checkerboard of 1 m cells, so that speed can be seen; right limbs are red, left limbs blue. With several robots
    the camera moves back until all are in the picture. The file appears under its name when it is complete: until
    :meth:`close` it is called ``<name>.partial``, and it is removed if the recording is left by an exception.

    Args:
        path: File to write, ending in ``.mp4``.
        num_robots: Number of humanoids, side by side on a plane.
        terrain: Shape of the ground; None for a plane.
        width: Picture width [px], even.
        height: Picture height [px], even.

    Raises:
        UserError: The path cannot be written or the size is not possible.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        num_robots: int = 1,
        terrain: Terrain | None = None,
        width: int = 640,
        height: int = 360,
    ) -> None:
        import imageio_ffmpeg  # here, as a machine that only trains may be without an encoder

        self._path = writable_path(path, ".mp4")
        if width < 64 or height < 64 or width % 2 or height % 2:
            raise UserError(f"a recording of {width}x{height} pixels is not possible; give even numbers of at least 64")
        if num_robots < 1:
            raise UserError(f"a recording of {num_robots} robots is not possible; give at least 1")
        self._file = WholeFile(self._path)
        self._stage = Stage(num_robots, terrain=terrain)
        rotation = facing(_AZIMUTH, _ELEVATION)
        self._backwards = rotations.rotate(rotation, torch.tensor([0.0, 0.0, 1.0]))  # the camera looks along its -z
        self._studio = Studio(self._stage, width, height, _FIELD_OF_VIEW, rotation)
        self._aim = _Aim(width / height)
        self._font = ImageFont.load_default(size=max(11, round(height / 22)))
        self._steps = 0
        writer = imageio_ffmpeg.write_frames(
            str(self._file.temporary),
            (width, height),
            fps=FRAME_RATE,
            quality=7,
            macro_block_size=2,
            codec="libx264",
            output_params=["-f", "mp4"],
        )
        self._writer: Generator[None, np.ndarray | None, None] | None = writer
        self._count_frames: Callable[[str], tuple[int | None, float | None]] = imageio_ffmpeg.count_frames_and_secs

    def add(
        self,
        root_position: torch.Tensor,
        root_rotation: torch.Tensor,
        joint_position: torch.Tensor,
        caption: str = "",
    ) -> None:
        """Add one control step; every second one becomes a frame. Arguments as in :meth:`Stage.pose`.

        Args:
            root_position: Pelvis positions [m], shape [n, 3].
            root_rotation: Pelvis rotations (x, y, z, w), shape [n, 4].
            joint_position: Joint angles [rad], shape [n, 28].
            caption: One line, written into the picture.
        """
        if self._writer is None:
            raise RuntimeError(f"the recording {self._path} is closed")
        try:
            if self._steps == 0:
                self._writer.send(None)  # starts the encoder
            if self._steps % _STEPS_PER_FRAME == 0:
                self._stage.pose(root_position, root_rotation, joint_position)
                self._writer.send(self._frame(caption))
        except OSError as error:  # its message is the encoder's whole log
            raise UserError(self._sorry) from error
        self._steps += 1

    def _frame(self, caption: str) -> np.ndarray:
        target, distance = self._aim.follow(self._stage.pelvis)
        picture = self._studio.photograph(target + distance * self._backwards)
        return _write_caption(picture, caption, self._font) if caption else picture

    def close(self) -> None:
        """Finish the file and give it its name. Closing twice is harmless.

        Raises:
            UserError: Nothing was added, or the disk does not take it; no file is left then.
        """
        if self._writer is None:
            return
        self._end()
        if self._steps == 0:
            raise UserError(f"nothing was added to {self._path}; no recording was written")
        if not self._is_whole():
            self._file.drop()
            raise UserError(self._sorry)
        self._file.keep()

    @property
    def _sorry(self) -> str:
        return f"cannot write {self._path} (the encoder could not go on); make room or choose another place"

    def _is_whole(self) -> bool:
        """Whether all frames are in the file: a full disk may show at its end, where the encoder does not say so."""
        try:
            frames, _ = self._count_frames(str(self._file.temporary))
        except (OSError, RuntimeError):
            return False
        return frames == math.ceil(self._steps / _STEPS_PER_FRAME)

    def abort(self) -> None:
        """Give up the recording and remove what was written."""
        self._end()
        self._file.drop()

    def _end(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


class _Aim:
    """What the camera looks at: the middle of all robots, and a distance at which all are in the picture."""

    def __init__(self, aspect: float) -> None:
        self._aspect = aspect
        self._tracker = Tracker(gain=0.12)
        self._height = 0.0

    def follow(self, pelvis: torch.Tensor) -> tuple[torch.Tensor, float]:
        """Point to look at [m], shape [3], and distance from it [m], for pelvises of shape [robots, 3]."""
        low, high = pelvis.amin(dim=0), pelvis.amax(dim=0)
        height = max(_VIEW_HEIGHT, (float((high - low)[:2].norm()) + 2.0) / self._aspect)
        self._height += (0.1 if self._height else 1.0) * (height - self._height)
        # Feet and head lie about evenly around a point a little below the pelvis frame's origin.
        target = self._tracker.follow(0.5 * (low + high)) - torch.tensor([0.0, 0.0, 0.06])
        # The nearest robot stands before the middle by half of the lanes' breadth.
        return target, 0.5 * self._height / math.tan(0.5 * _FIELD_OF_VIEW) + 0.5 * float((high - low)[1])


def _write_caption(picture: np.ndarray, caption: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont) -> np.ndarray:
    image = Image.fromarray(picture)
    margin = picture.shape[0] // 30
    ImageDraw.Draw(image).text((margin, margin), caption, fill=TEXT_COLOUR, font=font)
    return np.asarray(image)
