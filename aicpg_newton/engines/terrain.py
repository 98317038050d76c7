"""Uneven ground: a triangle mesh over a grid, the same for every engine, and the height at any point of it.

The mesh stands on a grid of square cells. Each cell is cut into two triangles along the diagonal from its corner with
the smallest x and y to the opposite one, which is how MuJoCo and Newton cut their height fields.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch

from aicpg_newton.errors import UserError
from aicpg_newton.ranges import SEED, Range, check_ranges

EDGE = 2.0
"""Strip along the border of the mesh on which no robot starts, and within half of which none may go on [m]."""

_MOST_VERTICES = 20_000_000
"""A mesh with more does not fit into memory beside its contacts."""

_STARTS = 40.0
"""Length of the strip along x in which robots start [m]."""


@dataclass(kw_only=True)
class Ground:
    """Shape of the ground."""

    height_range: Annotated[float, Range(0.0, 10.0)] = 0.0
    """Height of the highest above the lowest point [m]; 0 is an endless plane, the paper's terrain has 0.1."""
    shape: str = "random"
    """random: straight lines between random heights."""
    cell: Annotated[float, Range(0.0, 4 * EDGE, positive=True)] = 0.25
    """Spacing of the mesh's vertices [m]."""
    feature: Annotated[float, Range(0.0, 4 * EDGE, positive=True)] = 0.5
    """Spacing of the random heights [m], with straight lines between them: the smaller, the rougher."""
    length: Annotated[float, Range(4 * EDGE, 10_000.0)] = 320.0
    """Extent along x [m]: 40 to start in, then 60 s at more than 4 m/s."""
    width: Annotated[float, Range(4 * EDGE, 10_000.0)] = 32.0
    """Extent along y [m]."""
    levels: Annotated[int, Range(1, 1000)] = 1
    """Strips side by side with heights from 1/levels of the range to all of it; robots that last move on to the next,
    and from the last to any of them, others go back by one. 1 is no such curriculum."""
    level_strip: bool = False
    """Make the first strip level; the others then rise from 1/(levels - 1) of the range."""
    seed: Annotated[int, SEED] = 0
    """Seed of the heights."""

    def validate(self) -> None:
        """Refuse ground that cannot be built.

        Raises:
            UserError: A size is out of its range.
        """
        check_ranges(self, "ground.")
        if self.shape not in SHAPES:
            raise UserError(f"ground.shape is {self.shape!r}; choose one of: {', '.join(SHAPES)}")
        if self.cell > self.feature:
            raise UserError(
                f"ground.cell is {self.cell} and ground.feature {self.feature}; give a feature no smaller than the cell"
            )
        if not self.uneven and (self.levels > 1 or self.level_strip):
            raise UserError(f"ground.levels is {self.levels}, but ground.height_range is 0; give the strips a height")
        if self.level_strip and self.levels < 2:
            raise UserError("ground.level_strip takes one of ground.levels, which is 1; give at least 2")
        if self.width < 4 * EDGE * self.levels:
            raise UserError(
                f"ground.width is {self.width} and ground.levels {self.levels}; give {4 * EDGE} m for each level"
            )
        vertices = self.length * self.width / self.cell**2
        if self.uneven and vertices > _MOST_VERTICES:
            raise UserError(
                f"ground.length, width and cell make a mesh of {vertices:.1e} vertices, more than {_MOST_VERTICES:.0e};"
                " give a smaller ground or larger cells"
            )

    @property
    def uneven(self) -> bool:
        """Whether it is no plane."""
        return self.height_range > 0.0

    def unseen(self, seed: int) -> Ground:
        """This ground with the heights of another seed, of the full range everywhere: levels are for training."""
        return replace(self, seed=seed, levels=1, level_strip=False)


def random_heights(ground: Ground, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Random heights ``ground.feature`` apart, with straight lines between them (paper, Sec. III-C).

    Args:
        ground: Settings.
        x: Positions of the mesh's vertices along x, from 0 [m].
        y: The same across, from 0 [m].

    Returns:
        Surface over the vertices, shape [len(x), len(y)]; of any height, which is brought to the range asked for.
    """
    lattice = [int(np.ceil(axis[-1] / ground.feature)) + 1 for axis in (x, y)]
    random = np.random.default_rng(ground.seed).random(lattice)
    knots = [np.arange(count) * ground.feature for count in lattice]
    along_x = np.stack([np.interp(x, knots[0], column) for column in random.T], axis=1)
    return np.stack([np.interp(y, knots[1], row) for row in along_x])


SHAPES: dict[str, Callable[[Ground, np.ndarray, np.ndarray], np.ndarray]] = {"random": random_heights}
"""Kinds of uneven ground: functions with the arguments and the result of :func:`random_heights`."""


@dataclass(frozen=True)
class Terrain:
    """Heights of the mesh's vertices and what follows from them. World frame; x runs from 0, y is centred."""

    ground: Ground
    heights: torch.Tensor
    """Height at each vertex [m], shape [along x, along y]."""

    @classmethod
    def make(cls, ground: Ground) -> Terrain | None:
        """The terrain of these settings; None for a plane.

        Raises:
            UserError: A size is out of its range.
        """
        ground.validate()
        if not ground.uneven:
            return None
        cells = [round(extent / ground.cell) for extent in (ground.length, ground.width)]
        x, y = (np.arange(count + 1) * ground.cell for count in cells)
        surface = SHAPES[ground.shape](ground, x, y)
        surface = (surface - surface.min()) / np.ptp(surface) - 0.5
        strip = np.minimum(y / (y[-1] / ground.levels), ground.levels - 1).astype(int)
        strip = strip / (ground.levels - 1) if ground.level_strip else (strip + 1) / ground.levels
        heights = ground.height_range * surface * strip
        return cls(ground, torch.from_numpy(heights).float())

    def to(self, device: torch.device | str) -> Terrain:
        """The same terrain on another device."""
        return Terrain(self.ground, self.heights.to(device))

    @property
    def extent(self) -> tuple[float, float]:
        """Length along x and width along y [m], whole cells."""
        rows, columns = self.heights.shape
        return (rows - 1) * self.ground.cell, (columns - 1) * self.ground.cell

    def height(self, point: torch.Tensor) -> torch.Tensor:
        """Height of the surface [m]; beyond the mesh, that of its nearest triangle's plane.

        Args:
            point: x, y and whatever else [m], shape [..., 2 or more].

        Returns:
            Shape [...].
        """
        rows, columns = self.heights.shape
        # Where a robot's state is no longer finite, any height will do.
        across, up = torch.nan_to_num(point[..., 0]), torch.nan_to_num(point[..., 1]) + 0.5 * self.extent[1]
        across, up = across / self.ground.cell, up / self.ground.cell
        i, j = across.floor().clamp(0, rows - 2), up.floor().clamp(0, columns - 2)
        u, v = across - i, up - j
        first = (i * columns + j).long()
        flat = self.heights.flatten()
        low, far, left, opposite = flat[first], flat[first + columns], flat[first + 1], flat[first + columns + 1]
        below = far + (opposite - far) * v - (far - low) * (1.0 - u)
        above = left + (opposite - left) * u - (left - low) * (1.0 - v)
        return torch.where(u > v, below, above)

    def inside(self, point: torch.Tensor) -> torch.Tensor:
        """Whether a point is on the mesh and not at its very edge; arguments as for :meth:`height`."""
        length, width = self.extent
        margin = 0.5 * EDGE
        x, y = point[..., 0], point[..., 1]
        return (x > margin) & (x < length - margin) & (y.abs() < 0.5 * width - margin)

    def starts(self, level: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
        """Places to start at: anywhere in the first 40 m of a level's strip, away from its borders.

        Args:
            level: Level of each robot, from 0, shape [num_envs].
            share: Where in the area, each in [0, 1), shape [num_envs, 2].

        Returns:
            x, y [m], shape [num_envs, 2].
        """
        length, width = self.extent
        strip = width / self.ground.levels
        reach = min(_STARTS, 0.5 * length)
        x = EDGE + (reach - EDGE) * share[:, 0]
        y = -0.5 * width + strip * level + EDGE + (strip - 2 * EDGE) * share[:, 1]
        return torch.stack((x, y), dim=1)

    def vertices(self) -> np.ndarray:
        """Positions of the mesh's vertices [m], shape [vertices, 3]."""
        rows, columns = self.heights.shape
        x = np.arange(rows) * self.ground.cell
        y = np.arange(columns) * self.ground.cell - 0.5 * self.extent[1]
        return np.stack((*np.meshgrid(x, y, indexing="ij"), self.heights.cpu().numpy()), axis=-1).reshape(-1, 3)

    def triangles(self) -> np.ndarray:
        """Vertices of each triangle, counter-clockwise seen from above, shape [triangles, 3]."""
        rows, columns = self.heights.shape
        low = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1, 1)
        below = low + np.array([0, columns, columns + 1])
        above = low + np.array([0, columns + 1, 1])
        return np.stack((below, above), axis=1).reshape(-1, 3).astype(np.int32)
