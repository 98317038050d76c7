"""The robot's facts: links, joints, mass, size, motors, mirror map."""

import dataclasses
import xml.etree.ElementTree as ElementTree

import pytest
import torch

from aicpg_newton.errors import UserError
from aicpg_newton.robot import humanoid, kinematics, mirror, rotations
from aicpg_newton.robot.humanoid import JOINT_NAMES, LINK_NAMES, joint_index

STANDING = (torch.tensor([0.0, 0.0, 0.8815]), torch.tensor([0.0, 0.0, 0.0, 1.0]), torch.zeros(28))


def test_thirteen_links_twenty_eight_joints_and_48_9_kilograms():
    """The MJCF and the table name the paper's robot."""
    body = ElementTree.parse(humanoid.MJCF_PATH).getroot().find("worldbody/body")
    assert body is not None
    assert len(LINK_NAMES) == len(list(body.iter("body"))) == 13
    assert len(JOINT_NAMES) == len(list(body.iter("joint"))) == 28
    assert sum(float(geom.attrib["mass"]) for geom in body.iter("geom")) == pytest.approx(humanoid.TOTAL_MASS)
    assert not any(float(joint.attrib.get("stiffness", 0)) for joint in body.iter("joint"))


def test_leg_length_and_height():
    """From hip to the middle of the foot 0.855 m, from sole to crown 1.6 m."""
    positions, _ = kinematics.forward_kinematics(*STANDING)
    ankle = positions[LINK_NAMES.index("right_foot"), 2]
    foot_centre = ankle - 0.0225
    hip = positions[LINK_NAMES.index("right_thigh"), 2]
    assert float(hip - foot_centre) == pytest.approx(humanoid.LEG_LENGTH, abs=2e-3)
    crown = positions[LINK_NAMES.index("head"), 2] + humanoid.HEAD_CENTRE[2] + 0.095
    assert float(crown) == pytest.approx(1.6, abs=0.02)
    assert kinematics.sole_heights(*STANDING).tolist() == pytest.approx([0.0, 0.0], abs=1e-6)


def test_mirroring_a_pose_mirrors_every_link():
    """The mirror map agrees with a reflection of space, for random poses of all joints at once."""
    angles = 0.5 * torch.randn(20, 28, generator=torch.Generator().manual_seed(1))
    position, rotation = torch.zeros(20, 3), torch.tensor([0.0, 0.0, 0.0, 1.0]).expand(20, 4)
    links, turns = kinematics.forward_kinematics(position, rotation, angles)
    mirrored, mirrored_turns = kinematics.forward_kinematics(position, rotation, mirror.JOINTS(angles))
    swap = list(mirror.LINKS)
    assert torch.allclose(mirrored, links[:, swap] * torch.tensor([1.0, -1.0, 1.0]), atol=1e-6)
    # A reflection in y keeps the y component of a rotation's axis and turns the others around.
    expected = turns[:, swap] * torch.tensor([-1.0, 1.0, -1.0, 1.0])
    assert torch.allclose(mirrored_turns, expected, atol=1e-6)
    assert not torch.allclose(mirrored, links * torch.tensor([1.0, -1.0, 1.0]), atol=1e-2)


def test_mirroring_twice_is_the_identity():
    """The mirror map is an involution."""
    angles = torch.randn(5, 28)
    assert torch.equal(mirror.JOINTS(mirror.JOINTS(angles)), angles)


def test_joint_ranges_are_mirror_images():
    """Left and right ranges agree after reflection."""
    ranges = kinematics.skeleton().ranges
    lower, upper = mirror.JOINTS(ranges[:, 0]), mirror.JOINTS(ranges[:, 1])
    flipped = torch.tensor(mirror.JOINTS.sign) < 0
    assert torch.allclose(torch.where(flipped, upper, lower), ranges[:, 0])
    assert torch.allclose(torch.where(flipped, lower, upper), ranges[:, 1])


@pytest.mark.parametrize(
    ("joint", "angle", "link", "axis", "sign"),
    [
        ("right_hip_y", -0.5, "right_foot", 0, 1),  # hip flexion brings the foot forward
        ("left_knee", 0.5, "left_foot", 0, -1),  # knee flexion brings it back
        ("right_shoulder_y", -0.5, "right_lower_arm", 0, 1),  # shoulder flexion brings the arm forward
        ("left_elbow", -1.0, "left_lower_arm", 0, 0),  # the elbow's own origin stays
        ("right_hip_x", -0.4, "right_foot", 1, -1),  # abduction moves the right foot right
        ("left_hip_x", 0.4, "left_foot", 1, 1),  # and the left foot left
        ("abdomen_y", 0.4, "head", 0, 1),  # bending forward
    ],
)
def test_signs_of_joints(joint: str, angle: float, link: str, axis: int, sign: int):
    """Flexion, abduction and bending move the limb the way anatomy says."""
    angles = torch.zeros(28)
    angles[joint_index(joint)] = angle
    rest, _ = kinematics.forward_kinematics(*STANDING)
    moved, _ = kinematics.forward_kinematics(STANDING[0], STANDING[1], angles)
    shift = float((moved - rest)[LINK_NAMES.index(link), axis])
    assert abs(shift) < 1e-6 if sign == 0 else sign * shift > 0.05


def test_paper_gains():
    """Kp is 750 for the torso's three joints and 250 elsewhere; Kd is 1."""
    motors = humanoid.motors()
    torso = torch.tensor([name.startswith("abdomen") for name in JOINT_NAMES])
    assert torso.sum() == 3
    assert motors.position_gain[torso].unique().tolist() == [750.0]
    assert motors.position_gain[~torso].unique().tolist() == [250.0]
    assert motors.velocity_gain.unique().tolist() == [1.0]


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("position_gain", float("nan"), "position_gain of joint neck_x is nan"),
        ("torque_limit", 0.0, "torque_limit of joint neck_x is 0.0"),
        ("damping", -1.0, "damping of joint neck_x is -1.0"),
        ("armature", float("inf"), "armature of joint neck_x is inf"),
    ],
)
def test_bad_motors_are_refused(field: str, value: float, message: str):
    """A gain that is not a sensible number is named with its joint."""
    motors = humanoid.motors()
    values = getattr(motors, field).clone()
    values[joint_index("neck_x")] = value
    with pytest.raises(UserError, match=message):
        dataclasses.replace(motors, **{field: values})


def test_wrong_joint_count_is_refused():
    """Motors for 27 joints are not this robot's."""
    motors = humanoid.motors()
    with pytest.raises(UserError, match="28 joints"):
        dataclasses.replace(motors, damping=motors.damping[:-1])


def test_rotations_agree_with_matrices():
    """Quaternion product, rotation, Euler angles and the up axis agree with rotation matrices."""
    angles = torch.randn(10, 3, generator=torch.Generator().manual_seed(2))
    roll, pitch, yaw = angles[:, 0], 0.5 * angles[:, 1], angles[:, 2]
    q = rotations.from_roll_pitch_yaw(roll, pitch, yaw)
    c, s, zero, one = torch.cos, torch.sin, torch.zeros(10), torch.ones(10)

    def matrix(*rows: torch.Tensor) -> torch.Tensor:
        return torch.stack(rows, dim=1).view(10, 3, 3)

    rx = matrix(one, zero, zero, zero, c(roll), -s(roll), zero, s(roll), c(roll))
    ry = matrix(c(pitch), zero, s(pitch), zero, one, zero, -s(pitch), zero, c(pitch))
    rz = matrix(c(yaw), -s(yaw), zero, s(yaw), c(yaw), zero, zero, zero, one)
    expected = rz @ ry @ rx
    vectors = torch.randn(10, 3)
    assert torch.allclose(rotations.rotate(q, vectors), (expected @ vectors.unsqueeze(2)).squeeze(2), atol=1e-5)
    assert torch.allclose(rotations.up_axis(q), expected[:, :, 2], atol=1e-5)
    back = torch.stack(rotations.roll_pitch_yaw(q), dim=1)
    assert torch.allclose(back, torch.stack((roll, pitch, yaw), dim=1), atol=1e-5)
    hinges = rotations.from_euler_xyz(torch.stack((roll, pitch, yaw), dim=1))
    assert torch.allclose(
        rotations.rotate(hinges, vectors), (rx @ ry @ rz @ vectors.unsqueeze(2)).squeeze(2), atol=1e-5
    )
    identity = rotations.multiply(q, rotations.conjugate(q))
    assert torch.allclose(identity, torch.tensor([0.0, 0.0, 0.0, 1.0]).expand(10, 4), atol=1e-6)
