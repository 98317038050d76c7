"""Rhythm generator, pattern network file and PD law."""

import math
from pathlib import Path

import pytest
import torch

from aicpg_newton.errors import UserError
from aicpg_newton.gait import cpg
from aicpg_newton.gait.cpg import Gait, PatternNetwork


def made_up_network() -> PatternNetwork:
    """A network with random weights and two simple gaits."""
    torch.manual_seed(0)
    series = ((0.0, 0.0, 0.9, 0.0, 0.0, 0.0), (0.0,) * 6, (0.0, 0.02, 0.03, 0.0, 0.0, 0.0))
    walk = Gait(name="walk", source="a", frequency=0.9, speed=1.2, root_harmonics=series)
    run = Gait(name="run", source="b", frequency=1.3, speed=3.2, root_harmonics=series)
    return PatternNetwork((walk, run)).requires_grad_(False)


def test_window_samples_the_coming_control_steps():
    """Entry i of the window is the sine of the phase i control steps ahead (Eq. 1-2)."""
    frequency = torch.tensor([0.7, 1.4])
    window = cpg.rhythm_window(torch.tensor([0.3, 1.0]), frequency)
    assert window.shape == (2, 50)
    for env, phase in enumerate((0.3, 1.0)):
        for i in (0, 1, 49):
            expected = math.sin(phase + 2 * math.pi * float(frequency[env]) * i / 60)
            assert window[env, i].item() == pytest.approx(expected, abs=1e-5)


def test_advanced_phase_shifts_the_window():
    """One control step later the window has moved by one entry."""
    phase, frequency = torch.tensor([6.2]), torch.tensor([1.1])
    later = cpg.advance_phase(phase, frequency)
    assert 0.0 <= later.item() < 2 * math.pi
    now, soon = cpg.rhythm_window(phase, frequency), cpg.rhythm_window(later, frequency)
    assert torch.allclose(now[:, 1:], soon[:, :-1], atol=1e-5)


def test_one_stride_takes_one_over_f():
    """After 1/f seconds the phase is back, to float precision."""
    phase, frequency = torch.tensor([1.0]), torch.tensor([0.8])
    for _ in range(75):
        phase = cpg.advance_phase(phase, frequency)
    assert phase.item() == pytest.approx(1.0, abs=1e-4)


def test_phase_is_continuous_when_the_frequency_changes():
    """A frequency ramp never makes the phase jump, as sin(2 pi f t) would."""
    phase, largest = torch.zeros(1), 0.0
    for step in range(600):
        frequency = torch.tensor([0.7 + 0.023 * step / 60])
        later = cpg.advance_phase(phase, frequency)
        largest = max(largest, torch.remainder(later - phase, 2 * math.pi).item())
        phase = later
    assert largest <= 2 * math.pi * (0.7 + 0.023 * 10) / 60 + 1e-5


def test_pd_law():
    """Eq. 3-4 with both errors, by hand."""
    one = torch.ones(28)
    torque = cpg.pd_torque(0.2 * one, 3.0 * one, 0.1 * one, 1.0 * one, position_gain=250 * one, velocity_gain=one)
    assert torque.tolist() == pytest.approx([250 * 0.1 + 2.0] * 28, rel=1e-5)


def test_target_rate_is_the_change_to_the_next_target():
    """The rate leads exactly from this step's target to the next one's."""
    network = made_up_network()
    phase, frequency = torch.tensor([0.5, 6.25]), torch.tensor([0.9, 1.3])
    target, rate = network.target(phase, frequency)
    following, _ = network.target(cpg.advance_phase(phase, frequency), frequency)
    assert torch.allclose(target + rate / 60, following, atol=1e-5)


def test_root_motion_and_speed_lie_between_the_gaits():
    """The Fourier series is evaluated at the phase and interpolated over frequency; speed is extrapolated above.

    Below the slowest gait its length of stride stays.
    """
    network = made_up_network()
    motion = network.root_motion(torch.tensor([math.pi / 2]), torch.tensor([1.1]))
    assert motion[0].tolist() == pytest.approx([0.0, 0.02, 0.93, 0.0, 0.0, 0.0], abs=1e-6)
    speed = network.nominal_speed(torch.tensor([0.9, 1.1, 1.3, 1.4, 0.45, 0.0]))
    assert speed.tolist() == pytest.approx([1.2, 2.2, 3.2, 3.7, 0.6, 0.0], abs=1e-5)


def test_network_has_the_papers_layers():
    """50-128-128-28 with ReLU."""
    shapes = [tuple(value.shape) for value in made_up_network().state_dict().values() if value.ndim == 2]
    assert shapes == [(128, 50), (128, 128), (28, 128)]


def test_saved_network_is_the_same(tmp_path: Path):
    """Saving and loading keeps weights and gaits."""
    network = made_up_network()
    network.save(tmp_path / "s.pt")
    loaded = PatternNetwork.load(tmp_path / "s.pt")
    window = torch.rand(3, 50)
    assert torch.equal(network(window), loaded(window))
    assert [gait.frequency for gait in loaded.gaits] == [0.9, 1.3]
    assert loaded.gaits[0].root_harmonics == network.gaits[0].root_harmonics


def test_missing_torn_and_foreign_files(tmp_path: Path):
    """Each kind of bad file gets a sentence of its own."""
    with pytest.raises(UserError, match="no pattern network"):
        PatternNetwork.load(tmp_path / "none.pt")
    whole = tmp_path / "s.pt"
    made_up_network().save(whole)
    (tmp_path / "torn.pt").write_bytes(whole.read_bytes()[:2000])
    with pytest.raises(UserError, match="cut short"):
        PatternNetwork.load(tmp_path / "torn.pt")
    torch.save({"something": 1}, tmp_path / "other.pt")
    with pytest.raises(UserError, match="not a pattern network"):
        PatternNetwork.load(tmp_path / "other.pt")


def test_wrong_joint_count_and_weights_that_are_not_finite():
    """A network for other joints, or with a NaN, is refused."""
    content = made_up_network().content()
    with pytest.raises(UserError, match="27 joints"):
        PatternNetwork.from_content({**content, "joint_names": content["joint_names"][:-1]}, "file")
    weights = dict(content["weights"])
    weights["layers.0.bias"] = weights["layers.0.bias"] * float("nan")
    with pytest.raises(UserError, match="not finite"):
        PatternNetwork.from_content({**content, "weights": weights}, "file")
    del weights["layers.0.bias"]
    with pytest.raises(UserError, match="50-128-128-28"):
        PatternNetwork.from_content({**content, "weights": weights}, "file")
