"""What a motion prior sees of the humanoid at one instant, its mirror image, and the same of the imitated gaits."""

from __future__ import annotations

import math
from functools import cache

import torch

from aicpg_newton.engines.interface import BodyState
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.gait.poses import gait_pose
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import (
    CONTROL_DT,
    FOOT_NAMES,
    MIRROR_AXIAL,
    MIRROR_SIDES,
    MIRROR_VECTOR,
    NUM_JOINTS,
    mirror_blocks,
)
from aicpg_newton.robot.kinematics import forward_kinematics

BLOCKS = (
    ("root_height", 1),
    ("root_rotation", 6),
    ("linear_velocity", 3),
    ("angular_velocity", 3),
    ("joint_position", NUM_JOINTS),
    ("joint_velocity", NUM_JOINTS),
    ("hand_position", 6),
    ("foot_position", 6),
)
"""Name and size of each block, in order; hands and feet are ordered right, left."""

STYLE_SIZE = sum(size for _, size in BLOCKS)
"""81. The published state has 105: it gives each three-hinge joint as tangent and normal instead of three angles."""

HAND_CENTRE = (0.0, 0.0, -0.259)
"""Centre of the hand's sphere in the lower arm's frame [m]."""

_KEY_LINKS = ("right_lower_arm", "left_lower_arm", *FOOT_NAMES)


def style_state(state: BodyState, ground_height: torch.Tensor) -> torch.Tensor:
    """One instant as the discriminator sees it (Peng et al. 2021, Sec. 5.2; this humanoid in Isaac Gym).

    Vectors are in the heading frame: the world turned about the vertical by the pelvis's yaw. The pelvis rotation is
    given by its x axis and its z axis, hands and feet by their position relative to the pelvis. Joints stay angles, as
    each is a single hinge that never comes near a full turn.

    Args:
        state: Poses and velocities, of any batch shape.
        ground_height: Height of the ground below the pelvis in the world [m], shape [...].

    Returns:
        Style states, shape [..., 81], in the order of :data:`BLOCKS`.
    """
    to_heading = rotations.about_z(-rotations.yaw(state.root_rotation))
    tilt = rotations.multiply(to_heading, state.root_rotation)
    forward, _, up = torch.eye(3, dtype=tilt.dtype, device=tilt.device).expand(*tilt.shape[:-1], 3, 3).unbind(-2)
    origin = torch.zeros_like(state.root_position)
    links, link_rotations = forward_kinematics(origin, tilt, state.joint_position, _KEY_LINKS)
    hand = links.new_tensor(HAND_CENTRE).expand_as(links[..., :2, :])
    blocks = (
        (state.root_position[..., 2] - ground_height).unsqueeze(-1),
        rotations.rotate(tilt, forward),
        rotations.rotate(tilt, up),
        rotations.rotate(to_heading, state.root_linear_velocity),
        rotations.rotate(to_heading, state.root_angular_velocity),
        state.joint_position,
        state.joint_velocity,
        (links[..., :2, :] + rotations.rotate(link_rotations[..., :2, :], hand)).flatten(-2),
        links[..., 2:, :].flatten(-2),
    )
    return torch.cat(blocks, dim=-1)


@cache
def _mirror_map() -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Permutation and sign of a style state under a reflection y -> -y, which swaps right and left."""
    maps = {
        "root_height": ((0,), (1.0,)),
        "root_rotation": ((0, 1, 2, 3, 4, 5), MIRROR_VECTOR * 2),
        "linear_velocity": ((0, 1, 2), MIRROR_VECTOR),
        "angular_velocity": ((0, 1, 2), MIRROR_AXIAL),
        "hand_position": (MIRROR_SIDES, MIRROR_VECTOR * 2),
        "foot_position": (MIRROR_SIDES, MIRROR_VECTOR * 2),
    }
    return mirror_blocks(BLOCKS, maps)


def mirror(style: torch.Tensor) -> torch.Tensor:
    """Left-right mirror image of style states, shape [..., 81]; mirroring twice is the identity."""
    permutation, sign = _mirror_map()
    return style[..., list(permutation)] * style.new_tensor(sign)


def reference_motion(pattern: PatternNetwork, gait: str, *, phases: int = 512) -> torch.Tensor:
    """Style states of an imitated gait on flat ground, at its own frequency and speed, one control step apart.

    Velocities are differences over one control step, half of it before the instant and half after: any other would be
    ahead of the positions or behind, which a simulated body's are not.

    Args:
        pattern: The pattern network S.
        gait: Name of one of its gaits, ``walk`` or ``run``.
        phases: Number of phases, evenly spaced over a stride.

    Returns:
        States at each phase and one control step later, shape [phases, 2, 81].

    Raises:
        UserError: The pattern network has no such gait.
    """
    frequency, speed = pattern.gait(gait).frequency, pattern.gait(gait).speed
    device = next(pattern.parameters()).device
    phase = torch.arange(phases, device=device) * (2 * math.pi / phases)
    steps = torch.tensor([0.0, 1.0], device=device).unsqueeze(1) + torch.tensor([-0.5, 0.0, 0.5], device=device)
    around = phase.reshape(-1, 1, 1) + (2 * math.pi * CONTROL_DT * frequency) * steps
    with torch.no_grad():
        poses = gait_pose(pattern, around, torch.full_like(around, frequency))

    def rate(values: torch.Tensor) -> torch.Tensor:
        return (values[:, :, 2] - values[:, :, 0]) / CONTROL_DT

    rotation = poses.root_rotation
    progress = rotation.new_tensor((speed, 0.0, 0.0))
    middle = BodyState(
        root_position=poses.root_position[:, :, 1],
        root_rotation=rotation[:, :, 1],
        root_linear_velocity=rate(poses.root_position) + progress,
        root_angular_velocity=rotations.angular_velocity(rotation[:, :, 0], rotation[:, :, 2], CONTROL_DT),
        joint_position=poses.joint_position[:, :, 1],
        joint_velocity=rate(poses.joint_position),
    )
    return style_state(middle, ground_height=poses.root_position.new_zeros(phases, 2))
