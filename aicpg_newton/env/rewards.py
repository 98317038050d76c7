"""Reward terms of Eq. 5-8 as pure functions of tensors; the task weights them, the environment adds them up.

All take batches and return shape [num_envs]; the weights stand in :class:`aicpg_newton.env.task.RewardWeights`.
"""

from __future__ import annotations

from typing import Literal

import torch

from aicpg_newton.robot import rotations

PatternError = Literal["sum_of_magnitudes", "magnitude_of_sum"]
"""Reading of Eq. 7: sum_j |e_j|, or |sum_j e_j| as printed, in which errors of opposite sign cancel."""

VELOCITY_SCALE = 0.1
"""Scale of joint velocities in R_e [s/rad], as in the Isaac Gym humanoid."""


def head_height(head_position: torch.Tensor, ground_height: torch.Tensor | float = 0.0) -> torch.Tensor:
    """R_h: height of the head's centre above the ground below it [m].

    Args:
        head_position: World position of the head's centre [m], shape [num_envs, 3].
        ground_height: World height of the ground below it [m], shape [num_envs].
    """
    return head_position[:, 2] - ground_height


def reflex_energy(
    reflex_torque: torch.Tensor, joint_velocity: torch.Tensor, torque_limit: torch.Tensor
) -> torch.Tensor:
    """R_e = sum_j |tau_j w_j| + tau_j^2 of the reflex alone (Eq. 6).

    Torques count in units of the joint's limit and velocities in units of 10 rad/s, so that the term stays of the order
    of the survival reward.

    Args:
        reflex_torque: tau_r [N m], shape [num_envs, 28].
        joint_velocity: Joint velocities [rad/s], shape [num_envs, 28].
        torque_limit: Torque limit per joint [N m], shape [28].
    """
    torque = reflex_torque / torque_limit
    return (torch.abs(torque * VELOCITY_SCALE * joint_velocity) + torque**2).sum(dim=1)


def survival(root_position: torch.Tensor) -> torch.Tensor:
    """R_a: one for each step survived."""
    return torch.ones_like(root_position[:, 0])


def upright(root_rotation: torch.Tensor) -> torch.Tensor:
    """R_s = z_global . z_pelvis: 1 when the pelvis is upright, 0 when it lies.

    Args:
        root_rotation: Pelvis rotation (x, y, z, w), shape [num_envs, 4].
    """
    return rotations.up_axis(root_rotation)[:, 2]


def target_velocity(root_linear_velocity: torch.Tensor, target_direction: torch.Tensor) -> torch.Tensor:
    """R_d: velocity along the target direction [m/s].

    Args:
        root_linear_velocity: World velocity of the pelvis [m/s], shape [num_envs, 3].
        target_direction: Horizontal unit vector in the world, shape [num_envs, 2].
    """
    return (root_linear_velocity[:, :2] * target_direction).sum(dim=1)


def sideways_speed(root_linear_velocity: torch.Tensor, target_direction: torch.Tensor) -> torch.Tensor:
    """Speed across the target direction [m/s]; not in the paper, keeps the path straight. Arguments as above."""
    x, y = root_linear_velocity[:, :2].unbind(dim=1)
    return torch.abs(target_direction[:, 0] * y - target_direction[:, 1] * x)


def pattern_error(target: torch.Tensor, joint_position: torch.Tensor, reading: PatternError) -> torch.Tensor:
    """Error e of Eq. 7 [rad].

    Args:
        target: Target angles theta_t [rad], shape [num_envs, 28].
        joint_position: Joint angles theta [rad], shape [num_envs, 28].
        reading: How to sum over the joints.
    """
    error = target - joint_position
    return error.abs().sum(dim=1) if reading == "sum_of_magnitudes" else error.sum(dim=1).abs()


def pattern_tracking(error: torch.Tensor, bound: float) -> torch.Tensor:
    """R_g = 1 - e/b for e <= b, else 0 (Eq. 8).

    Args:
        error: e [rad], shape [num_envs].
        bound: b [rad].
    """
    return (1.0 - error / bound).clamp_min(0.0)


def target_speed(speed: torch.Tensor, wanted: float) -> torch.Tensor:
    """R_t of the PPO baseline: 1 at the wanted speed, falling straight to 0 at standstill and at twice that speed.

    The paper (Sec. III-A) says only that R_t sets the target velocity; this is the form of its R_g (Eq. 8) with the
    error of the speed for e and the wanted speed for b. Weighted like R_g it outweighs R_d, which always asks for more.

    Args:
        speed: Velocity along the target direction [m/s], shape [num_envs].
        wanted: Target speed [m/s].
    """
    return (1.0 - (speed - wanted).abs() / wanted).clamp_min(0.0)
