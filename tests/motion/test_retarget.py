"""Retargeting: signs, sides, frames and units."""

import math

import pytest
import torch

from aicpg_newton.errors import UserError
from aicpg_newton.motion.acclaim import read_motion, read_skeleton
from aicpg_newton.motion.retarget import euler_xyz, flat_soles, retarget
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import JOINT_NAMES, joint_index
from aicpg_newton.robot.kinematics import skeleton as humanoid_skeleton

ARMS_DOWN = {"lhumerus": (0.0, 0.0, 90.0), "rhumerus": (0.0, 0.0, -90.0)}


def angles_of(subject, **bones):
    """Joint angles [deg] of one frame by name, and the retargeted motion; other bones stand at ease, arms out."""
    skeleton = read_skeleton(subject.skeleton)
    soles = flat_soles(skeleton, read_motion(subject.motion("stand.amc", [{}] * 10), skeleton))
    motion = retarget(skeleton, read_motion(subject.motion("a.amc", [bones]), skeleton), soles)
    return dict(zip(JOINT_NAMES, torch.rad2deg(motion.angles[0]).tolist(), strict=True)), motion


def test_standing_is_zero_but_for_the_arms(subject):
    """Legs hang, feet are flat, arms out to the sides are 90 degrees of abduction: right negative x, left positive."""
    angles, motion = angles_of(subject)
    assert angles.pop("right_shoulder_x") == pytest.approx(-90, abs=1e-4)
    assert angles.pop("left_shoulder_x") == pytest.approx(90, abs=1e-4)
    others = {name: angle for name, angle in angles.items() if "shoulder_z" not in name}
    assert max(map(abs, others.values())) < 1e-4
    torch.testing.assert_close(motion.root_rotation[0], motion.root_rotation.new_tensor((0.0, 0.0, 0.0, 1.0)))


def test_a_raised_right_leg_is_negative_right_hip_y(subject):
    """40 degrees of hip flexion and 60 of knee flexion on the right show on the right and nowhere else."""
    angles, _ = angles_of(subject, rfemur=(-40.0, 0.0, 20.0), rtibia=(60.0,))
    assert angles["right_hip_y"] == pytest.approx(-40, abs=1e-4)
    assert angles["right_knee"] == pytest.approx(60, abs=1e-4)
    for joint in ("left_hip_y", "left_knee", "right_hip_x", "right_hip_z", "right_ankle_y", "abdomen_y"):
        assert angles[joint] == pytest.approx(0, abs=1e-4)


def test_splayed_legs_are_abducted(subject):
    """In Acclaim's rest pose the legs stand 20 degrees out: right hip_x negative, left positive."""
    angles, _ = angles_of(subject, rfemur=(0.0, 0.0, 0.0), lfemur=(0.0, 0.0, 0.0))
    assert angles["right_hip_x"] == pytest.approx(-20, abs=1e-4)
    assert angles["left_hip_x"] == pytest.approx(20, abs=1e-4)


def test_elbow_flexes_negative_and_lies_on_its_side(subject):
    """A positive Acclaim elbow angle is the humanoid's negative one."""
    angles, _ = angles_of(subject, lradius=(50.0,))
    assert angles["left_elbow"] == pytest.approx(-50, abs=1e-4)
    assert angles["right_elbow"] == pytest.approx(0, abs=1e-4)


def test_trunk_and_head_lean_forward_with_positive_y(subject):
    """Leaning forward is a positive rotation about y (left); the head's own lean shows in the neck."""
    angles, _ = angles_of(subject, thorax=(15.0, 0.0, 0.0), head=(-15.0, 0.0, 0.0))
    assert angles["abdomen_y"] == pytest.approx(15, abs=1e-4)
    assert angles["neck_y"] == pytest.approx(-15, abs=1e-4)


def test_toes_up_is_negative_ankle_y(subject):
    """Turning the foot about its own x axis moves ankle_y by the same angle, against the calibrated flat foot."""
    angles, _ = angles_of(subject, rfoot=(-10.0, 0.0))
    assert angles["right_ankle_y"] == pytest.approx(-10, abs=1e-4)
    assert angles["left_ankle_y"] == pytest.approx(0, abs=1e-4)


def test_root_is_between_the_hips_in_metres_and_z_up(subject):
    """Acclaim (left, up, forward) becomes (forward, left, up); turning left is a positive yaw."""
    _, motion = angles_of(subject, root=(1.0, 2.0, 3.0, 0.0, 30.0, 0.0))
    expected = torch.tensor([3.0, 1.0, 2.0], dtype=torch.float64) * 0.0254 / 0.45
    torch.testing.assert_close(motion.root_position[0], expected, atol=1e-8, rtol=0)
    roll, pitch, yaw = rotations.roll_pitch_yaw(motion.root_rotation[0])
    assert yaw.item() == pytest.approx(math.radians(30), abs=1e-6)
    assert abs(roll.item()) + abs(pitch.item()) < 1e-6
    assert motion.leg_ratio == pytest.approx(0.8315 / (15.0 * 0.0254 / 0.45), abs=1e-6)


def test_euler_xyz_inverts_the_hinges():
    """Angles go through the package's own intrinsic x-y-z convention and back."""
    angles = torch.tensor([[0.3, -1.1, 0.7], [-2.0, 0.4, 1.5]], dtype=torch.float64)
    axes = torch.eye(3, dtype=torch.float64)
    quaternion = rotations.from_euler_xyz(angles)
    matrix = torch.stack([rotations.rotate(quaternion, axes[i].expand(2, 3)) for i in range(3)], dim=-1)
    torch.testing.assert_close(euler_xyz(matrix), angles)


def test_a_skeleton_without_a_needed_bone_is_refused(subject):
    """The message names the bone."""
    del subject.bones["head"]
    subject.skeleton.write_text(subject.skeleton_text())
    with pytest.raises(UserError, match="no bone head"):
        angles_of(subject)


def test_a_real_walk_and_run_stay_within_the_joint_ranges(mocap):
    """35_08 and 35_17 overstep the humanoid's ranges by less than 5 degrees; knees and elbows bend the right way."""
    skeleton = read_skeleton(mocap / "35" / "35.asf")
    walk, run = (read_motion(mocap / "35" / f"35_{clip}.amc", skeleton) for clip in ("08", "17"))
    soles = flat_soles(skeleton, walk)
    low, high = humanoid_skeleton().ranges.double().T
    for motion in (walk, run):
        angles = retarget(skeleton, motion, soles).angles
        assert torch.rad2deg(torch.maximum(low - angles, angles - high)).max() < 5.0
        assert angles[:, joint_index("right_knee")].max() > math.radians(60)
        assert angles[:, joint_index("left_elbow")].max() < 0
