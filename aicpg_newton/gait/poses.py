"""The imitated gait as motion of the whole body: poses to play back, states to start from."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from aicpg_newton.engines.interface import BodyState
from aicpg_newton.gait.cpg import PatternNetwork, advance_phase, rhythm_window
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import CONTROL_DT
from aicpg_newton.robot.kinematics import sole_heights


@dataclass
class GaitPose:
    """Poses of the imitated gait near x = 0, each tensor of shape [..., 3], [..., 4] or [..., 28]."""

    root_position: torch.Tensor
    root_rotation: torch.Tensor
    joint_position: torch.Tensor


def gait_pose(pattern: PatternNetwork, phase: torch.Tensor, frequency: torch.Tensor) -> GaitPose:
    """The whole body at a phase of the imitated gait: angles from S, the pelvis from the gait's Fourier series.

    The pelvis stands as high as in the clip, and higher where a sole would be below the ground.

    Args:
        pattern: The pattern network S.
        phase: Phase [rad], shape [...].
        frequency: Stride frequency [Hz], shape [...].
    """
    joint_position = pattern(rhythm_window(phase, frequency))
    motion = pattern.root_motion(phase, frequency)
    roll, pitch, yaw = motion[..., 3], motion[..., 4], motion[..., 5]
    rotation = rotations.from_roll_pitch_yaw(roll, pitch, yaw)
    position = motion[..., :3].clone()
    position[..., 2] -= sole_heights(position, rotation, joint_position).amin(dim=-1).clamp_max(0.0)
    return GaitPose(root_position=position, root_rotation=rotation, joint_position=joint_position)


def gait_start(
    pattern: PatternNetwork, phase: torch.Tensor, frequency: torch.Tensor, forward_speed: torch.Tensor
) -> BodyState:
    """Start states on flat ground: the gait's pose, its velocities over the coming control step and a forward speed.

    Args:
        pattern: The pattern network S.
        phase: Phase [rad], shape [rows].
        frequency: Stride frequency [Hz], shape [rows].
        forward_speed: Steady speed along x [m/s], shape [rows].
    """
    both = torch.stack((phase, advance_phase(phase, frequency)))
    pose = gait_pose(pattern, both, frequency.expand_as(both))
    position, soon = pose.root_position
    rotation, turned = pose.root_rotation
    velocity = (soon - position) / CONTROL_DT
    velocity[:, 0] += forward_speed
    return BodyState(
        root_position=position,
        root_rotation=rotation,
        root_linear_velocity=velocity,
        root_angular_velocity=rotations.angular_velocity(rotation, turned, CONTROL_DT),
        joint_position=pose.joint_position[0],
        joint_velocity=(pose.joint_position[1] - pose.joint_position[0]) / CONTROL_DT,
    )
