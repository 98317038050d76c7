"""Supervised fit of the pattern network, and the shipped one."""

import math

import pytest
import torch

from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import (
    DEFAULT_PATTERN,
    Gait,
    PatternNetwork,
    advance_phase,
    rhythm_window,
)
from aicpg_newton.motion.cycles import GaitCycle
from aicpg_newton.motion.fit import fit_pattern_network
from aicpg_newton.robot.humanoid import NUM_JOINTS, joint_index
from aicpg_newton.robot.kinematics import skeleton
from aicpg_newton.robot.mirror import JOINTS

ROOT = ((0.0, 0.0, 0.85, 0.0, 0.0, 0.0), (0.0,) * 6, (0.0,) * 6)


def cycle(name, frequency, swing):
    """A symmetric gait: hips swing in opposition, knees bend half a stride apart."""
    phase = torch.arange(128) * (2 * math.pi / 128)
    angles = torch.zeros(128, NUM_JOINTS)
    for side, shift in (("right", 0.0), ("left", math.pi)):
        angles[:, joint_index(f"{side}_hip_y")] = -0.2 - swing * torch.sin(phase + shift)
        angles[:, joint_index(f"{side}_knee")] = swing * (1 + torch.cos(phase + shift))
    angles[:, joint_index("abdomen_z")] = 0.1 * torch.sin(phase)
    return GaitCycle(Gait(name, "synthetic", frequency, frequency, ROOT), angles)


def samples(frequency, count=256):
    """Phases over a stride and the frequency at each."""
    phase = torch.arange(count) * (2 * math.pi / count)
    return phase, torch.full_like(phase, frequency)


def test_a_fit_tells_the_gaits_apart_and_is_mirror_symmetric_between_them():
    """Gaits given fastest first come out slowest first, with errors; symmetry holds at frequencies never seen."""
    network = fit_pattern_network([cycle("run", 1.3, 0.8), cycle("walk", 0.9, 0.3)], steps=800)
    assert [gait.name for gait in network.gaits] == ["walk", "run"]
    for gait, swing in zip(network.gaits, (0.3, 0.8), strict=True):
        assert 0 < gait.fit_error < gait.worst_fit_error < 0.02
        hip = network(rhythm_window(*samples(gait.frequency)))[:, joint_index("right_hip_y")]
        assert hip.min().item() == pytest.approx(-0.2 - swing, abs=0.05)
    window = rhythm_window(*samples(1.1))
    torch.testing.assert_close(network(-window), JOINTS(network(window)), atol=1e-5, rtol=0)


def test_the_fit_error_is_that_of_the_angles():
    """The numbers in the gaits are the RMS over all joints and of the worst one."""
    walk = cycle("walk", 0.9, 0.3)
    network = fit_pattern_network([walk, cycle("run", 1.3, 0.8)], steps=20)
    square = (network(rhythm_window(*samples(0.9, 128))) - walk.angles).square()
    assert network.gaits[0].fit_error == pytest.approx(square.mean().sqrt().item(), rel=1e-4)
    assert network.gaits[0].worst_fit_error == pytest.approx(square.mean(dim=0).max().sqrt().item(), rel=1e-4)


def test_a_fit_repeats_and_leaves_the_random_state_alone():
    """Two fits give the same weights; the caller's random numbers go on as before."""
    gaits = [cycle("walk", 0.9, 0.3), cycle("run", 1.3, 0.8)]
    state = torch.get_rng_state()
    first, second = (fit_pattern_network(gaits, steps=5).state_dict() for _ in range(2))
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert torch.equal(torch.get_rng_state(), state)


def test_equal_frequencies_and_broken_angles_are_refused():
    """What cannot be told apart or learned is an error."""
    walk = cycle("walk", 0.9, 0.3)
    broken = cycle("run", 1.3, 0.8)
    broken.angles[3, 4] = math.nan
    for gaits, message in (([walk, walk], "different"), ([walk], "different"), ([walk, broken], "not finite")):
        with pytest.raises(UserError, match=message):
            fit_pattern_network(gaits, steps=1)


def test_nominal_speed_takes_a_single_frequency():
    """A tensor without dimensions is a frequency too."""
    network = PatternNetwork((cycle("walk", 0.9, 0.3).gait, cycle("run", 1.3, 0.8).gait))
    assert network.nominal_speed(torch.tensor(1.1)).item() == pytest.approx(1.1)


@pytest.fixture(scope="module")
def shipped():
    """The network in assets/."""
    return PatternNetwork.load()


def test_shipped_gaits(shipped):
    """Clips, frequencies, fit errors and size of the network that comes with the project."""
    walk, run = shipped.gaits
    assert (walk.name, walk.source, run.name, run.source) == ("walk", "35_08", "run", "35_17")
    assert walk.frequency == pytest.approx(0.903, rel=0.03)
    assert run.frequency == pytest.approx(1.327, rel=0.03)
    assert walk.speed == pytest.approx(1.15, abs=0.05)
    assert run.speed == pytest.approx(3.02, abs=0.1)
    for gait in shipped.gaits:
        assert gait.fit_error <= gait.worst_fit_error < 0.01
    assert DEFAULT_PATTERN.stat().st_size < 300_000


@pytest.mark.parametrize("frequency", [0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4])
def test_shipped_motion_at_every_frequency(shipped, frequency):
    """Symmetric, aligned, within the joint ranges, swinging as far as a walk at least, and smooth."""
    angles = shipped(rhythm_window(*samples(frequency)))
    torch.testing.assert_close(JOINTS(angles).roll(128, 0), angles, atol=1e-4, rtol=0)
    low, high = skeleton().ranges.T
    assert (torch.maximum(low - angles, angles - high)).max() < math.radians(3)
    flexion = angles[:, joint_index("left_hip_y")] - angles[:, joint_index("right_hip_y")]
    fundamental = torch.fft.rfft(flexion)[1] / 128
    assert math.degrees(abs(fundamental)) > 30
    # sin(phase) has the angle -90 degrees; away from the two gaits the network may lead or lag a little.
    assert math.degrees(torch.angle(fundamental).item()) == pytest.approx(-90, abs=20)
    spectrum = torch.fft.rfft(angles, dim=0).abs() / 128
    assert (spectrum[9:].square().sum(dim=0) / 2).sqrt().max() < 0.02
    knee = angles[:, joint_index("right_knee")]
    assert math.radians(55) < knee.max() < math.radians(120)
    # Knees bend most while the same leg swings forward, in the half stride around phase 0.
    assert math.cos(2 * math.pi * knee.argmax().item() / 256) > 0


def test_shipped_phase_is_accumulated_smoothly(shipped):
    """While f ramps through the range, no target angle moves faster than 20 rad/s."""
    phase, before = torch.zeros(1), None
    for step in range(300):
        frequency = torch.full((1,), 0.7 + 0.7 * step / 300)
        angles, _ = shipped.target(phase, frequency)
        if before is not None:
            assert ((angles - before).abs() * 60).max() < 20
        before, phase = angles, advance_phase(phase, frequency)
