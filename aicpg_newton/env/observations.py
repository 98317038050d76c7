"""What the reflex network sees, as a pure function of the state, and its left-right mirror image."""

from __future__ import annotations

from functools import cache

import torch

from aicpg_newton.engines.interface import RobotState
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import (
    GRAVITY,
    MIRROR_AXIAL,
    MIRROR_SIDES,
    MIRROR_VECTOR,
    NUM_JOINTS,
    TOTAL_MASS,
    mirror_blocks,
)

BLOCKS = (
    ("root_height", 1),
    ("linear_velocity", 3),
    ("angular_velocity", 3),
    ("pitch_roll_target", 3),
    ("up_and_heading", 2),
    ("joint_position", NUM_JOINTS),
    ("joint_velocity", NUM_JOINTS),
    ("joint_torque", NUM_JOINTS),
    ("foot_force", 6),
    ("foot_moment", 6),
    ("reflex_torque", NUM_JOINTS),
    ("target", NUM_JOINTS),
    ("cpg_torque", NUM_JOINTS),
)
"""Name and size of each block, in order."""

NUM_OBSERVATIONS = sum(size for _, size in BLOCKS)
"""192 (paper, Sec. II-A.2); the baselines have no ``target`` and ``cpg_torque`` and see 136."""

BODY_WEIGHT = TOTAL_MASS * GRAVITY
"""Unit of foot forces [N]."""

FOOT_LEVER = 0.1
"""Times the body weight, the unit of foot moments [m]: about the distance from ankle to toe."""


def observe(
    state: RobotState,
    *,
    ground_height: torch.Tensor | float = 0.0,
    torque: torch.Tensor,
    torque_limit: torch.Tensor,
    target_heading: torch.Tensor,
    control: tuple[torch.Tensor, ...],
) -> torch.Tensor:
    """Observations of the reflex network (paper, Sec. II-A.2).

    Vectors are in the heading frame: the world turned about the vertical by the pelvis's yaw. The yaw itself would be
    the angle to the target once more, so pitch stands in its place; up projection alone has no sign for it.

    Args:
        state: Robot state after the last control step.
        ground_height: World height of the ground below the pelvis [m], shape [num_envs].
        torque: tau_r of the last step [N m], shape [num_envs, 28].
        torque_limit: Torque limit per joint [N m], shape [28]; torques are given in units of it.
        target_heading: Yaw of the target direction in the world [rad], shape [num_envs].
        control: What the way of control adds: for AI-CPG theta_t [rad] and tau_g in units of the limit, each of shape
            [num_envs, 28]; for the baselines nothing.

    Returns:
        Observations in the order of :data:`BLOCKS`: shape [num_envs, 192], or the first 136 without the CPG.
    """
    roll, pitch, yaw = rotations.roll_pitch_yaw(state.root_rotation)
    angle_to_target = torch.remainder(target_heading - yaw + torch.pi, 2 * torch.pi) - torch.pi
    # All vectors at once: on a CPU the number of operations costs more than their size.
    vectors = torch.cat(
        (
            state.root_linear_velocity.unsqueeze(1),
            state.root_angular_velocity.unsqueeze(1),
            state.foot_force / BODY_WEIGHT,
            state.foot_moment / (BODY_WEIGHT * FOOT_LEVER),
        ),
        dim=1,
    )
    to_heading = rotations.about_z(-yaw).unsqueeze(1).expand(-1, vectors.shape[1], 4)
    vectors = rotations.rotate(to_heading, vectors).flatten(1)
    up = rotations.up_axis(state.root_rotation)[:, 2]
    blocks = (
        (state.root_position[:, 2] - ground_height).unsqueeze(1),
        vectors[:, :6],
        torch.stack((pitch, roll, angle_to_target, up, torch.cos(angle_to_target)), dim=1),
        state.joint_position,
        state.joint_velocity,
        state.joint_torque / torque_limit,
        vectors[:, 6:],
        torque / torque_limit,
        *control,
    )
    return torch.cat(blocks, dim=1)


@cache
def _mirror_map() -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Permutation and sign of all observations under a reflection y -> -y, which swaps right and left."""
    maps = {
        "root_height": ((0,), (1.0,)),
        "linear_velocity": ((0, 1, 2), MIRROR_VECTOR),
        "angular_velocity": ((0, 1, 2), MIRROR_AXIAL),
        "pitch_roll_target": ((0, 1, 2), (1.0, -1.0, -1.0)),
        "up_and_heading": ((0, 1), (1.0, 1.0)),
        "foot_force": (MIRROR_SIDES, MIRROR_VECTOR * 2),
        "foot_moment": (MIRROR_SIDES, MIRROR_AXIAL * 2),
    }
    return mirror_blocks(BLOCKS, maps)


def mirror_map(size: int) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Permutation and sign under a reflection y -> -y: ``mirrored[i] = sign[i] * observed[permutation[i]]``.

    Args:
        size: 192, or 136 without the CPG, whose observations are the first blocks.
    """
    permutation, sign = _mirror_map()
    return permutation[:size], sign[:size]


def mirror(observations: torch.Tensor) -> torch.Tensor:
    """Left-right mirror image of observations, shape [..., 192 or 136]; mirroring twice is the identity."""
    permutation, sign = mirror_map(observations.shape[-1])
    return observations[..., list(permutation)] * observations.new_tensor(sign)
