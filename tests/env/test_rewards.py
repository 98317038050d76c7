"""Reward terms against values worked out by hand."""

import math

import pytest
import torch

from aicpg_newton.env import rewards
from aicpg_newton.robot import rotations


def test_head_height_and_survival():
    """R_h is the height of the head and R_a is one."""
    head = torch.tensor([[9.0, 8.0, 1.5], [0.0, 0.0, 1.2]])
    assert rewards.head_height(head).tolist() == pytest.approx([1.5, 1.2])
    assert rewards.survival(head).tolist() == [1.0, 1.0]


def test_reflex_energy():
    """Eq. 6 in units of the limit: |0.5 x 0.1 x 4| + 0.25 for one joint, twice that square for both signs."""
    torque, velocity = torch.zeros(1, 28), torch.zeros(1, 28)
    torque[0, 3], velocity[0, 3] = -25.0, 4.0
    torque[0, 7] = 10.0
    limit = torch.full((28,), 50.0)
    limit[7] = 20.0
    assert rewards.reflex_energy(torque, velocity, limit).item() == pytest.approx(0.2 + 0.25 + 0.25)


def test_upright():
    """R_s is 1 upright, cos 60 degrees tilted by 60 degrees whatever the yaw, 0 lying."""
    tilt = torch.tensor([0.0, math.pi / 3, math.pi / 2])
    q = rotations.from_roll_pitch_yaw(torch.zeros(3), tilt, torch.tensor([0.3, 2.0, -1.0]))
    assert rewards.upright(q).tolist() == pytest.approx([1.0, 0.5, 0.0], abs=1e-6)


def test_target_velocity_and_sideways_speed():
    """R_d is the velocity along the target direction, negative when going back; the rest is sideways."""
    velocity = torch.tensor([[2.0, 1.0, 9.0], [2.0, 1.0, 9.0], [-2.0, 0.0, 0.0]])
    direction = torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    assert rewards.target_velocity(velocity, direction).tolist() == pytest.approx([2.0, 1.0, -2.0])
    assert rewards.sideways_speed(velocity, direction).tolist() == pytest.approx([1.0, 2.0, 0.0])


def test_pattern_error_readings():
    """Errors of opposite sign cancel in Eq. 7 as printed and add up in the sum of magnitudes."""
    target, position = torch.zeros(1, 28), torch.zeros(1, 28)
    target[0, 0], position[0, 1] = 1.0, 0.75
    assert rewards.pattern_error(target, position, "sum_of_magnitudes").item() == pytest.approx(1.75)
    assert rewards.pattern_error(target, position, "magnitude_of_sum").item() == pytest.approx(0.25)


def test_pattern_tracking():
    """R_g falls on a straight line from 1 at no error to 0 at b, and stays there (Eq. 8)."""
    error = torch.tensor([0.0, 0.5, 2.5, 7.0])
    assert rewards.pattern_tracking(error, 2.5).tolist() == pytest.approx([1.0, 0.8, 0.0, 0.0])
