"""The whole range at once: slow and fast, up and down while moving, pushed, on level and on rough ground.

Not in the paper, whose tasks are ``flat`` and ``uneven``; ``docs/robust.md`` says what was found on the way.
"""

from __future__ import annotations

import torch

from aicpg_newton.engines.terrain import Ground
from aicpg_newton.env.rewards import RewardTerm, pattern_terms
from aicpg_newton.env.task import Frequencies, Pushes, Task
from aicpg_newton.env.view import View


def turned_away(view: View, free: float) -> torch.Tensor:
    """1 - cos of what the pelvis is turned away from the target direction by beyond a free angle.

    Args:
        view: After the step.
        free: Angle [rad] that costs nothing: a pelvis swings about the vertical in every stride.
    """
    return 1.0 - torch.cos((view.angle_to_target.abs() - free).clamp_min(0.0))


def robust() -> Task:
    """A wider range of f than it is tested on, f that changes in mid-episode, pushes, and strips from 0 to 12 cm."""
    task = Task(
        name="robust",
        ground=Ground(height_range=0.12, levels=7, level_strip=True, length=160.0, width=63.0),
        frequencies=Frequencies(minimum=0.65, maximum=1.45, change_interval=4.0, change_rate=0.25, jumps=0.1),
        pushes=Pushes(force=200.0, interval=2.0, grow_with_level=True),  # from nothing, all at once is too much
    )
    # At the paper's weight of 1 a longer training trades the imitated gait for speed: goose steps, 2.9 m/s at 0.9 Hz.
    task.rewards["target_velocity"].weight = 0.4
    # In slow walking that hardly asks to turn back after a push, and turned away is as good as fallen.
    task.rewards["turned_away"] = RewardTerm(turned_away, -4.0, {"free": 0.25})
    # Pushed robots fall less if staying up is worth more; with 5 they would spend a quarter more energy on it. But they
    # hop at 0.7 Hz, unless the pattern is worth more too.
    task.rewards["survival"].weight = 2.0
    task.rewards |= pattern_terms()
    task.rewards["pattern_tracking"].weight = 8.0
    # Angles alone let it hop at 0.7 Hz all the same, at twice the energy.
    task.rewards["bounce"].weight = -3.0
    return task
