"""What a motion prior sees of the humanoid at one instant, its mirror image, and the same of the imitated gaits.

(Peng et al. 2021, Sec. 5.2; this humanoid in Isaac Gym.) Vectors are in the heading frame: the world turned about the
vertical by the pelvis's yaw. The pelvis rotation is given by its x axis and its z axis, hands and feet by where they
are from the pelvis. Joints stay angles, as each is a single hinge that never comes near a full turn; the published
state has 105 numbers, as it gives each three-hinge joint as tangent and normal.
"""

from __future__ import annotations

import math

import torch

from aicpg_newton.device import MadeOnce
from aicpg_newton.engines.interface import BodyState
from aicpg_newton.env.observations import Block, observe
from aicpg_newton.env.view import BodyView, derived
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.gait.poses import gait_pose
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import CONTROL_DT, FOOT_NAMES, HAND_CENTRE, HAND_LINKS
from aicpg_newton.robot.kinematics import forward_kinematics
from aicpg_newton.robot.mirror import AXIAL, EVEN, JOINTS, VECTOR, VECTORS_OF_SIDES


class StyleView(BodyView):
    """Bodies at an instant, with what the blocks below share."""

    @derived
    def tilt(self) -> torch.Tensor:
        """Pelvis rotation in the heading frame (x, y, z, w), shape [..., 4]."""
        return rotations.multiply(self.to_heading, self.state.root_rotation)

    def axis(self, number: int) -> torch.Tensor:
        """An axis of the pelvis (0: x, 1: y, 2: z) in the heading frame, shape [..., 3]."""
        unit = torch.eye(3, dtype=self.tilt.dtype, device=self.tilt.device)[number]
        return rotations.rotate(self.tilt, unit.expand(*self.tilt.shape[:-1], 3))

    def vector(self, world: torch.Tensor) -> torch.Tensor:
        """A vector of the world in the heading frame, shape [..., 3]."""
        return rotations.rotate(self.to_heading, world)

    @derived
    def hands_and_feet(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Positions of hands and of ankles from the pelvis, in the heading frame [m], each of shape [..., 2, 3]."""
        origin = torch.zeros_like(self.state.root_position)
        links = (*HAND_LINKS, *FOOT_NAMES)
        positions, turned = forward_kinematics(origin, self.tilt, self.state.joint_position, links)
        hand = _hand_centre(positions.device, positions.dtype).expand_as(positions[..., :2, :])
        return positions[..., :2, :] + rotations.rotate(turned[..., :2, :], hand), positions[..., 2:, :]


@MadeOnce
def _hand_centre(device: torch.device, dtype: torch.dtype) -> torch.Tensor:
    return torch.tensor(HAND_CENTRE, device=device, dtype=dtype)


BLOCKS: tuple[Block[StyleView], ...] = (
    Block("root_height", EVEN, lambda view: view.height.unsqueeze(-1)),
    Block("root_forward", VECTOR, lambda view: view.axis(0)),
    Block("root_up", VECTOR, lambda view: view.axis(2)),
    Block("linear_velocity", VECTOR, lambda view: view.vector(view.state.root_linear_velocity)),
    Block("angular_velocity", AXIAL, lambda view: view.vector(view.state.root_angular_velocity)),
    Block("joint_position", JOINTS, lambda view: view.state.joint_position),
    Block("joint_velocity", JOINTS, lambda view: view.state.joint_velocity),
    Block("hand_position", VECTORS_OF_SIDES, lambda view: view.hands_and_feet[0].flatten(-2)),
    Block("foot_position", VECTORS_OF_SIDES, lambda view: view.hands_and_feet[1].flatten(-2)),
)
"""A style state: 81 numbers. Hands and feet are ordered right, left."""


def style_state(state: BodyState, ground_height: torch.Tensor) -> torch.Tensor:
    """One instant as the discriminator sees it.

    Args:
        state: Poses and velocities, of any batch shape.
        ground_height: Height of the ground below the pelvis in the world [m], shape [...].

    Returns:
        Style states, shape [..., 81], in the order of :data:`BLOCKS`.
    """
    return observe(BLOCKS, StyleView(state, ground_height))


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
