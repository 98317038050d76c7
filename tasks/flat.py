"""Walking and running in a straight line on flat ground (paper, Sec. III-A)."""

from __future__ import annotations

from aicpg_newton.env.task import Task


def flat() -> Task:
    """Frequencies 0.8 to 1.4 Hz on a plane; every setting is the default of :mod:`aicpg_newton.env.task`."""
    return Task(name="flat")
