"""The 192 numbers the reflex network sees, as a pure function of the state, and their left-right mirror image."""

from __future__ import annotations

from functools import cache

import torch

from aicpg_newton import rotations
from aicpg_newton.engines.interface import RobotState
from aicpg_newton.humanoid import GRAVITY, MIRROR_PERMUTATION, MIRROR_SIGN, NUM_JOINTS, TOTAL_MASS

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
"""192 (paper, Sec. II-A.2)."""

BODY_WEIGHT = TOTAL_MASS * GRAVITY
"""Unit of foot forces [N]."""

FOOT_LEVER = 0.1
"""Times the body weight, the unit of foot moments [m]: about the distance from ankle to toe."""


def observe(
    state: RobotState,
    *,
    target: torch.Tensor,
    cpg_torque: torch.Tensor,
    reflex_torque: torch.Tensor,
    torque_limit: torch.Tensor,
    target_heading: torch.Tensor,
) -> torch.Tensor:
    """Observations of the reflex network (paper, Sec. II-A.2).

    Vectors are in the heading frame: the world turned about the vertical by the pelvis's yaw. The yaw itself would be
    the angle to the target once more, so pitch stands in its place; up projection alone has no sign for it.

    Args:
        state: Robot state after the last control step.
        target: Target angles theta_t [rad], shape [num_envs, 28].
        cpg_torque: tau_g of Eq. 4 at this instant [N m], shape [num_envs, 28].
        reflex_torque: tau_r of the last step [N m], shape [num_envs, 28].
        torque_limit: Torque limit per joint [N m], shape [28]; torques are given in units of it.
        target_heading: Yaw of the target direction in the world [rad], shape [num_envs].

    Returns:
        Observations, shape [num_envs, 192], in the order of :data:`BLOCKS`.
    """
    roll, pitch, yaw = rotations.roll_pitch_yaw(state.root_rotation)
    to_heading = rotations.about_z(-yaw)
    angle_to_target = torch.remainder(target_heading - yaw + torch.pi, 2 * torch.pi) - torch.pi
    per_foot = to_heading.unsqueeze(1).expand(-1, 2, 4)
    blocks = (
        state.root_position[:, 2:],
        rotations.rotate(to_heading, state.root_linear_velocity),
        rotations.rotate(to_heading, state.root_angular_velocity),
        torch.stack((pitch, roll, angle_to_target), dim=1),
        torch.stack((rotations.up_axis(state.root_rotation)[:, 2], torch.cos(angle_to_target)), dim=1),
        state.joint_position,
        state.joint_velocity,
        state.joint_torque / torque_limit,
        rotations.rotate(per_foot, state.foot_force).flatten(1) / BODY_WEIGHT,
        rotations.rotate(per_foot, state.foot_moment).flatten(1) / (BODY_WEIGHT * FOOT_LEVER),
        reflex_torque / torque_limit,
        target,
        cpg_torque / torque_limit,
    )
    return torch.cat(blocks, dim=1)


@cache
def _mirror_map() -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Permutation and sign of all observations under a reflection y -> -y, which swaps right and left."""
    vector, axial, feet = (1.0, -1.0, 1.0), (-1.0, 1.0, -1.0), (3, 4, 5, 0, 1, 2)
    joints = (MIRROR_PERMUTATION, MIRROR_SIGN)
    maps = {
        "root_height": ((0,), (1.0,)),
        "linear_velocity": ((0, 1, 2), vector),
        "angular_velocity": ((0, 1, 2), axial),
        "pitch_roll_target": ((0, 1, 2), (1.0, -1.0, -1.0)),
        "up_and_heading": ((0, 1), (1.0, 1.0)),
        "foot_force": (feet, vector * 2),
        "foot_moment": (feet, axial * 2),
    }
    permutation: list[int] = []
    sign: list[float] = []
    for name, _ in BLOCKS:
        block_permutation, block_sign = maps.get(name, joints)
        start = len(permutation)
        permutation += [start + index for index in block_permutation]
        sign += block_sign
    return tuple(permutation), tuple(sign)


def mirror(observations: torch.Tensor) -> torch.Tensor:
    """Left-right mirror image of observations, shape [..., 192]; mirroring twice is the identity."""
    permutation, sign = _mirror_map()
    return observations[..., list(permutation)] * observations.new_tensor(sign)
