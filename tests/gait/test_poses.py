"""The imitated gait as motion of the whole body."""

import math

import pytest
import torch

from aicpg_newton.gait.cpg import PatternNetwork, advance_phase
from aicpg_newton.gait.poses import gait_pose, gait_start
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import CONTROL_DT
from aicpg_newton.robot.kinematics import sole_heights


@pytest.fixture
def stride() -> tuple[torch.Tensor, torch.Tensor]:
    """Phases of a stride at frequencies from 0.7 to 1.5 Hz."""
    return torch.linspace(0, 2 * math.pi, 40), torch.linspace(0.7, 1.5, 40)


def test_poses_have_no_sole_below_the_ground(pattern: PatternNetwork, stride):
    """And the angles are those of S."""
    pose = gait_pose(pattern, *stride)
    assert sole_heights(pose.root_position, pose.root_rotation, pose.joint_position).min() > -1e-5
    assert torch.allclose(pose.joint_position, pattern.target(*stride)[0], atol=1e-6)


def test_a_start_is_the_pose_with_its_velocities(pattern: PatternNetwork, stride):
    """One control step at the start's velocities leads to the next pose, moved on by the forward speed."""
    phase, frequency = stride
    speed = torch.linspace(0.0, 3.0, 40)
    start = gait_start(pattern, phase, frequency, speed)
    now, soon = (gait_pose(pattern, each, frequency) for each in (phase, advance_phase(phase, frequency)))
    assert torch.allclose(start.root_position, now.root_position)
    assert torch.allclose(start.joint_position, now.joint_position)
    moved = start.root_position + CONTROL_DT * start.root_linear_velocity
    moved[:, 0] -= CONTROL_DT * speed
    assert torch.allclose(moved, soon.root_position, atol=1e-6)
    assert torch.allclose(start.joint_velocity, pattern.target(phase, frequency)[1], atol=1e-3)
    turn = CONTROL_DT * start.root_angular_velocity
    angle = turn.norm(dim=1)
    turned = rotations.multiply(rotations.about_axis(turn / angle.unsqueeze(1), angle), start.root_rotation)
    assert torch.allclose((turned * soon.root_rotation).sum(dim=1).abs(), torch.ones(40), atol=1e-5)
    assert start.root_angular_velocity.abs().max() > 0.5
