"""Contacts and the Froude number by hand."""

import pytest
import torch

from aicpg_newton.robot.locomotion import feet_on_ground, froude_number


def test_froude_number():
    """2.05 m/s is 4.2025 / (9.81 x 0.855) = 0.501, as the paper says of the transition."""
    assert froude_number(torch.tensor(2.05)).item() == pytest.approx(0.50104, abs=1e-4)


def test_feet_on_ground():
    """5 % of 48.9 kg x 9.81 m/s^2 are 24 N, upwards; sideways force is not support."""
    force = torch.tensor([[[0.0, 0.0, 23.0], [0.0, 0.0, 25.0]], [[400.0, 0.0, 0.0], [0.0, 0.0, -400.0]]])
    assert feet_on_ground(force).tolist() == [[False, True], [False, False]]
