"""Filmstrips: strides at several frequencies as rows of side views, for papers and quick looks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from aicpg_newton.errors import UserError
from aicpg_newton.viewing.camera import BACKGROUND, Photographer, facing, parallel_rays
from aicpg_newton.viewing.output import TEXT_COLOUR, writable_path
from aicpg_newton.viewing.stage import Ground, Stage

POSES = 8
"""Poses in a row."""

TILE_WIDTH, TILE_HEIGHT = 200, 240
"""Size of a pose's picture [px]."""

LABEL_WIDTH = 150
"""Width of the column of labels [px]."""

_PIXEL = 1.9 / TILE_HEIGHT
"""Edge of a pixel [m]."""
_FLOOR_ROW = TILE_HEIGHT - 18
_FLOOR_COLOUR, _LINE_COLOUR = (222, 225, 229), (120, 125, 132)


@dataclass(frozen=True)
class FilmstripRow:
    """Eight poses of one stride, evenly spaced in time."""

    label: str
    """What stands at the left, as ``0.9 Hz``; a line feed begins a smaller second line, as the measured speed."""
    root_position: torch.Tensor
    """Pelvis positions [m], world frame with x forward and the floor at z = 0, shape [8, 3]."""
    root_rotation: torch.Tensor
    """Pelvis rotations (x, y, z, w), shape [8, 4]."""
    joint_position: torch.Tensor
    """Joint angles [rad], shape [8, 28]."""


def save_filmstrip(path: Path | str, rows: list[FilmstripRow]) -> None:
    """Write strides as a PNG: one row per frequency, eight poses from left to right, forward to the right.

    Each pose is drawn without perspective, seen from the robot's right side, with its pelvis in the middle of its tile:
    robots do not overlap, and heights above the floor line can be compared.

    Args:
        path: File to write, ending in ``.png``.
        rows: What to show, from top to bottom.

    Raises:
        UserError: The path cannot be written, or the rows are none, of wrong shape or not finite.
    """
    path = writable_path(path, ".png")
    if not rows:
        raise UserError("a filmstrip needs at least one row; none was given")
    for row in rows:
        title = row.label.replace("\n", " ")
        if len(row.root_position) != POSES:
            raise UserError(f"row '{title}' of the filmstrip has {len(row.root_position)} poses; give {POSES}")
        for values in (row.root_position, row.root_rotation, row.joint_position):
            if not bool(torch.isfinite(values).all()):
                raise UserError(f"row '{title}' of the filmstrip has a pose that is not finite; give finite poses")
    stage = Stage(ground=Ground.NONE)
    rays = parallel_rays(TILE_WIDTH, TILE_HEIGHT, _PIXEL, _FLOOR_ROW, stage.model.device)
    photographer = Photographer(stage, rays)
    strip = np.concatenate([_row(row, stage, photographer) for row in rows])
    image = Image.fromarray(strip)
    draw = ImageDraw.Draw(image)
    title_font, text_font = ImageFont.load_default(size=26), ImageFont.load_default(size=19)
    for index, row in enumerate(rows):
        title, _, text = row.label.partition("\n")
        middle = (index + 0.5) * TILE_HEIGHT
        draw.text((16, middle - 32), title, fill=TEXT_COLOUR, font=title_font)
        draw.text((16, middle + 4), text, fill=TEXT_COLOUR, font=text_font)
    image.save(path)


def _row(row: FilmstripRow, stage: Stage, photographer: Photographer) -> np.ndarray:
    """Picture of one row, shape [TILE_HEIGHT, LABEL_WIDTH + 8 TILE_WIDTH, 3]."""
    view, camera = facing(0.0, 0.0), torch.tensor([0.0, -1.5, 0.0])
    tiles = [np.full((TILE_HEIGHT, LABEL_WIDTH, 3), BACKGROUND, dtype=np.uint8)]
    for pose in range(POSES):
        position = row.root_position[pose : pose + 1].cpu() * torch.tensor([0.0, 0.0, 1.0])
        stage.pose(position, row.root_rotation[pose : pose + 1], row.joint_position[pose : pose + 1])
        picture, shapes = photographer.shoot(camera, view)
        empty = shapes == len(stage.shape_names)
        empty[:_FLOOR_ROW] = False
        picture[empty] = _FLOOR_COLOUR
        # A foot that sinks into the floor stays in front of the line, so that it is seen.
        picture[_FLOOR_ROW : _FLOOR_ROW + 2][empty[_FLOOR_ROW : _FLOOR_ROW + 2]] = _LINE_COLOUR
        tiles.append(picture)
    return np.concatenate(tiles, axis=1)
