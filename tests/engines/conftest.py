"""Where soles are above uneven ground."""

from collections.abc import Callable

import pytest
import torch

from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.robot.kinematics import sole_corners

SPACING = 41
"""Points along and across a sole, 4 and 2 mm apart."""


def _clearance(
    terrain: Terrain, root_position: torch.Tensor, root_rotation: torch.Tensor, joint_position: torch.Tensor
) -> torch.Tensor:
    """Height [m] of each sole above the ground where it is least, shape [num_envs, 2]."""
    share = torch.linspace(0.0, 1.0, SPACING)
    across, along = torch.meshgrid(share, share, indexing="ij")
    weight = torch.stack(
        ((1 - along) * (1 - across), (1 - along) * across, along * (1 - across), along * across), dim=-1
    )
    points = weight.flatten(0, 1) @ sole_corners(root_position, root_rotation, joint_position)
    return (points[..., 2] - terrain.height(points)).amin(dim=-1)


@pytest.fixture
def clearance() -> Callable[[Terrain, torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]:
    """Least height of each sole above the ground, from terrain, root position, root rotation and joint angles."""
    return _clearance
