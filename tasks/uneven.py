"""The same on a triangle mesh with 10 cm between its highest and its lowest point (paper, Sec. III-C)."""

from __future__ import annotations

from aicpg_newton.engines.terrain import Ground
from aicpg_newton.env.task import Task


def uneven() -> Task:
    """All else as on flat ground; ``--ground.levels 8`` adds a curriculum, which the paper does not have."""
    return Task(name="uneven", ground=Ground(height_range=0.1))
