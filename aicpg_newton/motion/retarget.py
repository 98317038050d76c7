"""Acclaim motion to the humanoid's 28 joint angles, by bone directions.

Each of the humanoid's links follows one bone (or the trunk's line): its long axis lies along the bone, and its twist
comes from the hinge the bone carries, the knee for the thigh, the elbow for the upper arm, so that the humanoid's knee
and elbow, which are plain hinges about y, bend in the subject's own plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from aicpg_newton.errors import UserError
from aicpg_newton.motion.acclaim import FRAME_RATE, Motion, Pose, Skeleton, pose
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import NUM_JOINTS, joint_index
from aicpg_newton.robot.kinematics import skeleton as humanoid_skeleton

HUMANOID_FROM_ACCLAIM = torch.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], dtype=torch.float64)
"""Acclaim's x left, y up, z forward become the humanoid's x forward, y left, z up."""

SIDES = ("right", "left")

_LEGS = (0.3, 1.4)
"""Lengths of people's thigh and shin together, children's included [m]."""

_FLAT_SHARE = 0.125
"""Share of a walk's frames in which a foot surely lies flat: about half of its mid-stance."""


@dataclass(frozen=True)
class RetargetedMotion:
    """A clip on the humanoid, still in the subject's size and place."""

    source: str
    angles: torch.Tensor
    """Joint angles [rad] in the order of ``JOINT_NAMES``, shape [frames, 28]."""
    root_position: torch.Tensor
    """Middle between the hips [m], frame x forward, y left, z up of the laboratory, shape [frames, 3]."""
    root_rotation: torch.Tensor
    """Pelvis rotation (x, y, z, w) in the same frame, shape [frames, 4]."""
    balls: torch.Tensor
    """Balls of the right and the left foot [m] in the same frame, shape [frames, 2, 3]."""
    leg_length: float
    """Thigh and shin of the subject, mean of both sides [m]."""

    @property
    def leg_ratio(self) -> float:
        """Length of the humanoid's thigh and shin over the subject's."""
        return humanoid_leg_length() / self.leg_length


def humanoid_leg_length() -> float:
    """Thigh and shin of the humanoid [m]."""
    tree = humanoid_skeleton()
    shin, foot = (tree.offsets[_link(f"right_{joint}")].norm() for joint in ("knee", "ankle_x"))
    return float(shin + foot)


def _link(joint: str) -> int:
    """Link that a joint moves."""
    return next(link for link, joints in enumerate(humanoid_skeleton().joints) if joint_index(joint) in joints)


def euler_xyz(rotation: torch.Tensor) -> torch.Tensor:
    """Angles of three intrinsic hinges with R = Rx Ry Rz [rad], shape [..., 3, 3] to [..., 3].

    The middle angle lies within +-90 degrees; ``rotations.from_euler_xyz`` is the inverse.
    """
    return torch.stack(
        (
            torch.atan2(-rotation[..., 1, 2], rotation[..., 2, 2]),
            torch.asin(rotation[..., 0, 2].clamp(-1.0, 1.0)),
            torch.atan2(-rotation[..., 0, 1], rotation[..., 0, 0]),
        ),
        dim=-1,
    )


def _quaternion(rotation: torch.Tensor) -> torch.Tensor:
    """Quaternion (x, y, z, w) of a rotation matrix, shape [..., 3, 3] to [..., 4]."""
    return rotations.from_euler_xyz(euler_xyz(rotation))


def frame_from(up: torch.Tensor, left: torch.Tensor) -> torch.Tensor:
    """Rotation whose z axis lies along ``up`` and whose y axis comes closest to ``left``, shapes [..., 3]."""
    z = torch.nn.functional.normalize(up, dim=-1)
    x = torch.nn.functional.normalize(torch.linalg.cross(left.expand_as(z), z), dim=-1)
    return torch.stack((x, torch.linalg.cross(z, x), z), dim=-1)


class _Subject:
    """A pose over time in the humanoid's axes, and the rest-pose facts of the bones."""

    def __init__(self, skeleton: Skeleton, motion: Motion) -> None:
        needed = {
            f"{side[0]}{bone}"
            for side in SIDES
            for bone in ("hipjoint", "femur", "tibia", "foot", "toes", "clavicle", "humerus", "radius")
        }
        absent = sorted((needed | {"thorax", "head"}) - set(skeleton.bones))
        if absent:
            raise UserError(f"{skeleton.source} has no bone {absent[0]}; give a skeleton with CMU's bone names")
        self.skeleton = skeleton
        self.pose: Pose = pose(skeleton, motion)

    def rotation(self, bone: str) -> torch.Tensor:
        return HUMANOID_FROM_ACCLAIM @ self.pose.rotations[bone] @ HUMANOID_FROM_ACCLAIM.T

    def end(self, bone: str) -> torch.Tensor:
        return self.pose.ends[bone] @ HUMANOID_FROM_ACCLAIM.T

    def direction(self, bone: str) -> torch.Tensor:
        """Direction in the rest pose."""
        return HUMANOID_FROM_ACCLAIM @ self.skeleton.bones[bone].direction

    def hinge(self, bone: str) -> torch.Tensor:
        """Axis of the bone's flexion (its own x axis) in the rest pose."""
        return HUMANOID_FROM_ACCLAIM @ self.skeleton.bones[bone].axis[:, 0]

    def limb(self, bone: str, lower: str, bend: float) -> torch.Tensor:
        """Frame of a limb's upper or lower link: z up along the bone, y along (bend 1) or against (-1) the hinge."""
        return self.rotation(bone) @ frame_from(-self.direction(bone), bend * self.hinge(lower))


def flat_soles(skeleton: Skeleton, walk: Motion) -> dict[str, torch.Tensor]:
    """How each sole lies in its foot bone, seen while the foot stands flat.

    An Acclaim skeleton does not say where the sole is: the foot bone runs from the ankle down to the ball, and in the
    rest pose the feet are tilted with the splayed legs. The frames in which ankle and ball both move least are those
    of a flat foot on a level floor; this must be a walk, as a runner's foot never rests.

    Args:
        skeleton: The subject's skeleton.
        walk: A walk of the same subject.

    Returns:
        Per side the rotation from the sole's frame (x to the toes, z up) to the foot bone's, shape [3, 3].
    """
    subject = _Subject(skeleton, walk)
    soles = {}
    for side in SIDES:
        foot = f"{side[0]}foot"
        rotation = subject.rotation(foot)
        path = torch.cat((subject.end(f"{side[0]}tibia"), subject.end(foot)), dim=-1)
        speed = torch.gradient(path, dim=0)[0].norm(dim=-1)
        flat = speed.argsort()[: max(1, int(_FLAT_SHARE * len(speed)))]
        toes = rotation[flat] @ subject.direction(f"{side[0]}toes")
        up = toes.new_tensor((0.0, 0.0, 1.0)).expand_as(toes)
        sole = frame_from(up, torch.linalg.cross(up, toes))
        left, _, right = torch.linalg.svd((rotation[flat].mT @ sole).mean(dim=0))
        soles[side] = left @ right
    return soles


def retarget(skeleton: Skeleton, motion: Motion, soles: dict[str, torch.Tensor]) -> RetargetedMotion:
    """Joint angles and root pose of every frame.

    Args:
        skeleton: The subject's skeleton.
        motion: A motion of the same subject.
        soles: Result of :func:`flat_soles`.

    Raises:
        UserError: The skeleton lacks a bone that the humanoid needs.
    """
    subject = _Subject(skeleton, motion)
    pelvis = subject.rotation("root")
    shoulders = subject.end("lclavicle") - subject.end("rclavicle")
    torso = frame_from(subject.end("thorax") - subject.end("root"), shoulders)
    head = subject.rotation("head")
    angles = pelvis.new_zeros(len(pelvis), NUM_JOINTS)

    def ball(joint: str, parent: torch.Tensor, child: torch.Tensor) -> None:
        first = joint_index(f"{joint}_x")
        angles[:, first : first + 3] = euler_xyz(parent.mT @ child)

    def hinge(joint: str, parent: torch.Tensor, child: torch.Tensor) -> None:
        relative = parent.mT @ child
        angles[:, joint_index(joint)] = torch.atan2(relative[:, 0, 2], relative[:, 2, 2])

    ball("abdomen", pelvis, torso)
    ball("neck", torso, head)
    for side in SIDES:
        femur, tibia, foot, humerus, radius = (
            side[0] + bone for bone in ("femur", "tibia", "foot", "humerus", "radius")
        )
        thigh, shin = subject.limb(femur, tibia, 1.0), subject.limb(tibia, tibia, 1.0)
        # Acclaim's elbow and knee both flex by a positive angle; the humanoid's elbow flexes by a negative one.
        upper_arm, lower_arm = subject.limb(humerus, radius, -1.0), subject.limb(radius, radius, -1.0)
        ball(f"{side}_hip", pelvis, thigh)
        hinge(f"{side}_knee", thigh, shin)
        ball(f"{side}_ankle", shin, subject.rotation(foot) @ soles[side])
        ball(f"{side}_shoulder", torso, upper_arm)
        hinge(f"{side}_elbow", upper_arm, lower_arm)
    bones = skeleton.bones
    leg_length = 0.5 * sum(bones[side[0] + bone].length for side in SIDES for bone in ("femur", "tibia"))
    if not _LEGS[0] <= leg_length <= _LEGS[1]:
        raise UserError(
            f"thigh and shin of {skeleton.source} are {leg_length:.2f} m long, but people's {_LEGS[0]} to {_LEGS[1]}:"
            " its unit of length may not be what it says; mend it"
        )
    return RetargetedMotion(
        source=motion.source.removesuffix(".amc"),
        angles=angles,
        root_position=0.5 * (subject.end("lhipjoint") + subject.end("rhipjoint")),
        root_rotation=_quaternion(pelvis),
        balls=torch.stack([subject.end(f"{side[0]}foot") for side in SIDES], dim=1),
        leg_length=leg_length,
    )


def frame_times(frames: int) -> torch.Tensor:
    """Times of a clip's frames [s], shape [frames]."""
    return torch.arange(frames, dtype=torch.float64) / FRAME_RATE
