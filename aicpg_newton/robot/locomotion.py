"""Which feet carry the body, and how fast a gait is for legs of this length."""

from __future__ import annotations

import torch

from aicpg_newton.robot.humanoid import GRAVITY, LEG_LENGTH, TOTAL_MASS

CONTACT_FORCE = 0.05 * TOTAL_MASS * GRAVITY
"""A foot that carries more than this is on the ground [N]. 5 % of body weight, 24 N: the level used with force plates
(20 to 50 N), more than twice the weight of a foot, and far less than the load of any real support."""


def froude_number(speed: torch.Tensor) -> torch.Tensor:
    """Fr = v^2 / (g L) (Eq. 11, dimensionless) of forward speeds [m/s], any shape; L = 0.855 m."""
    return speed.square() / (GRAVITY * LEG_LENGTH)


def feet_on_ground(foot_force: torch.Tensor) -> torch.Tensor:
    """Whether each foot bears more than :data:`CONTACT_FORCE`, shape [..., 2, 3] [N] to [..., 2]."""
    return foot_force[..., 2] > CONTACT_FORCE
