"""What the robots are told to do."""

from __future__ import annotations

from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Commands:
    """What each robot is told in a control step; every tensor has shape [num_envs]. A change makes a new object.

    :meth:`aicpg_newton.env.environment.Environment.command` is the one place where they are set.
    """

    frequency: torch.Tensor
    """Stride frequency f [Hz]."""
    heading: torch.Tensor
    """Yaw of the target direction in the world [rad]."""
    speed: torch.Tensor | None = None
    """Speed to reach [m/s]; None where none is told."""
