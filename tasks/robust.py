"""The whole range at once: slow and fast, up and down while moving, pushed, on level and on rough ground.

Not in the paper, whose tasks are ``flat`` and ``uneven``; ``docs/robust.md`` says what was found on the way.
"""

from __future__ import annotations

from aicpg_newton.engines.terrain import Ground
from aicpg_newton.env.task import Frequencies, Pushes, Task, Termination


def robust() -> Task:
    """A wider range of f than it is tested on, f that changes in mid-episode, pushes, and strips from 0 to 12 cm.

    Pushes grow from strip to strip as the ground does: all at once is too much for a network that cannot walk yet.
    """
    return Task(
        name="robust",
        ground=Ground(height_range=0.12, levels=7, level_strip=True, length=160.0, width=63.0),
        frequencies=Frequencies(minimum=0.65, maximum=1.45, change_interval=4.0, change_rate=0.25, jumps=0.1),
        pushes=Pushes(force=200.0, interval=2.0, grow_with_level=True),
        termination=Termination(maximum_heading=57.0),  # pushed robots that walk slowly turn away half as often
    )
