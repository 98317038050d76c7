"""Filmstrips: strides at several frequencies as rows of side views, for papers and quick looks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.errors import UserError
from aicpg_newton.files import WholeFile
from aicpg_newton.viewing.camera import BACKGROUND, Photographer, checkerboard, facing, parallel_rays, relief
from aicpg_newton.viewing.output import TEXT_COLOUR, writable_path
from aicpg_newton.viewing.stage import Floor, Stage

POSES = 8
"""Poses in a row."""

TILE_WIDTH, TILE_HEIGHT = 200, 240
"""Size of a pose's picture [px]."""

LABEL_WIDTH = 150
"""Width of the column of labels [px]."""

_PIXEL = 1.9 / TILE_HEIGHT
"""Edge of a pixel [m]."""
_FLOOR_ROW = TILE_HEIGHT - 18
_ELEVATION = math.radians(12.0)
"""How far from above a terrain is seen [rad]; a plane is seen from the side."""
_CUT = 0.45
"""A terrain is cut away this far from the pelvis, before and behind it [m]."""
_GAP = 4
"""Half the distance between the strips of neighbouring poses, which do not belong together [px]."""
_CUT_ROW = TILE_HEIGHT - 10
"""Row where level ground is cut."""

_DrawTile = Callable[[torch.Tensor, torch.Tensor, torch.Tensor], np.ndarray]
"""Draws root position [1, 3], root rotation [1, 4] and joint angles [1, 28] as a tile, shape [height, width, 3]."""

_FLOOR_COLOUR, _LINE_COLOUR = (222, 225, 229), (120, 125, 132)


@dataclass(frozen=True)
class FilmstripRow:
    """Eight poses of one stride, evenly spaced in time."""

    label: str
    """What stands at the left, as ``0.9 Hz``; a line feed begins a smaller second line, as the measured speed."""
    root_position: torch.Tensor
    """Pelvis positions [m], world frame with x forward, shape [8, 3]."""
    root_rotation: torch.Tensor
    """Pelvis rotations (x, y, z, w), shape [8, 4]."""
    joint_position: torch.Tensor
    """Joint angles [rad], shape [8, 28]."""


def save_filmstrip(path: Path | str, rows: list[FilmstripRow], terrain: Terrain | None = None) -> None:
    """Write strides as a PNG: one row per frequency, eight poses from left to right, forward to the right.

    Each pose is drawn without perspective, seen from the robot's right side, with its pelvis in the middle of its tile:
    robots do not overlap, and heights above the floor line can be compared. On a terrain each pose stands on its own
    strip of ground, seen slightly from above: the ground below the pelvis is at the same height in all tiles, the line
    is the surface where the strip is cut off at the robot's right, and one-metre cells are light and dark.

    Args:
        path: File to write, ending in ``.png``.
        rows: What to show, from top to bottom.
        terrain: Shape of the ground; None for a plane at z = 0.

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
    draw_tile = _side_view() if terrain is None else _cut_view(terrain)
    strip = np.concatenate([_row(row, draw_tile) for row in rows])
    image = Image.fromarray(strip)
    draw = ImageDraw.Draw(image)
    title_font, text_font = ImageFont.load_default(size=26), ImageFont.load_default(size=19)
    for index, row in enumerate(rows):
        title, _, text = row.label.partition("\n")
        middle = (index + 0.5) * TILE_HEIGHT
        draw.text((16, middle - 32), title, fill=TEXT_COLOUR, font=title_font)
        draw.text((16, middle + 4), text, fill=TEXT_COLOUR, font=text_font)
    with WholeFile(path) as temporary:
        image.save(temporary, format="PNG")


def _row(row: FilmstripRow, draw_tile: _DrawTile) -> np.ndarray:
    """Picture of one row, shape [TILE_HEIGHT, LABEL_WIDTH + 8 TILE_WIDTH, 3]."""
    tiles = [np.full((TILE_HEIGHT, LABEL_WIDTH, 3), BACKGROUND, dtype=np.uint8)]
    for pose in range(POSES):
        now = slice(pose, pose + 1)
        tiles.append(draw_tile(row.root_position[now].cpu(), row.root_rotation[now], row.joint_position[now]))
    return np.concatenate(tiles, axis=1)


def _side_view() -> _DrawTile:
    """What draws a pose on a floor line."""
    stage = Stage(floor=Floor.NONE)
    photographer = Photographer(stage)
    rays = parallel_rays(TILE_WIDTH, TILE_HEIGHT, _PIXEL, _FLOOR_ROW, 0.0, stage.model.device)
    view, camera = facing(0.0, 0.0), torch.tensor([0.0, -1.5, 0.0])

    def draw(position: torch.Tensor, rotation: torch.Tensor, joint_position: torch.Tensor) -> np.ndarray:
        stage.pose(position * torch.tensor([0.0, 0.0, 1.0]), rotation, joint_position)
        shot = photographer.shoot(rays, camera, view)
        empty = shot.shapes == len(stage.shape_names)
        empty[:_FLOOR_ROW] = False
        shot.colour[empty] = _FLOOR_COLOUR
        # A foot that sinks into the floor stays in front of the line, so that it is seen.
        shot.colour[_FLOOR_ROW : _FLOOR_ROW + 2][empty[_FLOOR_ROW : _FLOOR_ROW + 2]] = _LINE_COLOUR
        return shot.colour

    return draw


def _cut_view(terrain: Terrain) -> _DrawTile:
    """What draws a pose on a strip of terrain."""
    stage = Stage(terrain=terrain)
    photographer = Photographer(stage)
    rays = parallel_rays(TILE_WIDTH, TILE_HEIGHT, _PIXEL, _CUT_ROW, _ELEVATION, stage.model.device)
    view, ground = facing(0.0, _ELEVATION), stage.shape_names.index("ground")
    pixel = np.array(_PIXEL)
    across = (torch.arange(TILE_WIDTH) + 0.5 - 0.5 * TILE_WIDTH) * _PIXEL
    beside = np.abs(np.arange(TILE_WIDTH) + 0.5 - 0.5 * TILE_WIDTH) > 0.5 * TILE_WIDTH - _GAP
    above = (_CUT_ROW - torch.arange(TILE_HEIGHT) - 0.5) * _PIXEL / math.cos(_ELEVATION)

    def draw(position: torch.Tensor, rotation: torch.Tensor, joint_position: torch.Tensor) -> np.ndarray:
        stage.pose(position, rotation, joint_position)
        camera = position[0] - torch.tensor([0.0, _CUT, 0.0])
        camera[2] = stage.ground_height(position[0])
        shot = photographer.shoot(rays, camera, view)
        x = camera[0] + across
        profile = stage.ground_height(torch.stack((x, camera[1].expand_as(x)), dim=1))
        cut = (camera[2] + above[:, None] < profile).numpy()
        behind = math.cos(_ELEVATION) * shot.depth
        cut[:, beside] = False
        floor = (shot.shapes == ground) & (behind < 2.0 * _CUT) & ~beside
        tone = checkerboard(x.numpy(), float(camera[1]) + behind, pixel, pixel) * relief(shot.normal)
        picture = np.where((shot.shapes < ground)[..., None], shot.colour, np.array(BACKGROUND, dtype=np.uint8))
        picture[floor] = (shot.colour * tone[..., None]).clip(0, 255)[floor]
        picture[cut] = _FLOOR_COLOUR
        picture[cut & ~np.roll(cut, 2, axis=0)] = _LINE_COLOUR
        return picture

    return draw
