"""Stride frequency and cycles."""

import math
import warnings
from dataclasses import replace

import pytest
import torch

from aicpg_newton.errors import UserError
from aicpg_newton.motion.acclaim import read_motion, read_skeleton
from aicpg_newton.motion.cycles import (
    PHASES,
    cycle_sole_heights,
    evaluate_series,
    fourier_series,
    gait_cycle,
    remove_glitches,
    straighten,
    stride_frequency,
)
from aicpg_newton.motion.retarget import flat_soles, retarget
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import joint_index
from aicpg_newton.robot.mirror import JOINTS

RIGHT_HIP, LEFT_HIP, KNEE = (joint_index(name) for name in ("right_hip_y", "left_hip_y", "right_knee"))

# Stride frequency [Hz] of every clip by harmonic fit, and floor slope [deg]; independent of this code.
CLIPS = {
    "35_08": (0.903, -0.05),
    "35_17": (1.327, -0.13),
    "35_01": (0.890, -0.15),
    "35_23": (1.354, 0.02),
    "35_25": (1.394, -0.20),
    "09_06": (1.354, -0.18),
    "07_01": (0.927, 1.16),
    "07_05": (0.643, 1.19),
    "07_12": (1.144, 1.09),
    "02_01": (0.903, 0.94),
    "02_03": (1.310, 0.91),
}


def retargeted(skeleton_path, motion_path, soles_path=None):
    """A clip on the humanoid, its soles seen in another clip or in itself."""
    skeleton = read_skeleton(skeleton_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        motion = read_motion(motion_path, skeleton)
    stand = motion if soles_path is None else read_motion(soles_path, skeleton)
    return retarget(skeleton, motion, flat_soles(skeleton, stand))


def synthetic(subject, frequency, seconds, **options):
    """A synthetic gait on the humanoid."""
    return retargeted(
        subject.skeleton, subject.motion("gait.amc", subject.stride_frames(frequency, seconds, **options))
    )


def cycle_phase():
    """Phases of a cycle's samples."""
    return torch.arange(PHASES, dtype=torch.float64) * (2 * math.pi / PHASES)


@pytest.mark.parametrize(("frequency", "seconds"), [(0.7, 3.1), (0.93, 2.0), (1.37, 1.25)])
def test_stride_frequency_of_short_clips(subject, frequency, seconds):
    """A clip of 1.7 strides still gives its frequency to half a percent."""
    assert stride_frequency(synthetic(subject, frequency, seconds)) == pytest.approx(frequency, rel=0.005)


def test_the_cycle_is_closed_symmetric_and_aligned(subject):
    """Phase convention, half-stride mirror symmetry, speed in metres scaled by the legs."""
    motion = synthetic(subject, 0.93, 2.9)
    cycle = gait_cycle(motion, "walk")
    torch.testing.assert_close(JOINTS(cycle.angles).roll(PHASES // 2, 0), cycle.angles, atol=1e-5, rtol=0)
    flexion = (cycle.angles[:, LEFT_HIP] - cycle.angles[:, RIGHT_HIP]).double().unsqueeze(-1)
    _, cosine, sine = fourier_series(flexion, 1).squeeze(-1).tolist()
    assert sine == pytest.approx(math.radians(50), rel=0.02)
    assert abs(cosine) < 1e-4
    strides = round(2 * 120.0 / 0.93)
    progress = float((motion.root_position[strides] - motion.root_position[0]).norm())
    assert cycle.gait.speed == pytest.approx(0.5 * 0.93 * progress * motion.leg_ratio, rel=0.01)
    step = (cycle.angles.roll(-1, 0) - cycle.angles).abs()
    assert step[-1].max() <= step[:-1].max()  # no jump where the cycle closes
    assert math.isnan(cycle.gait.fit_error)
    # The right knee of the synthetic gait bends most as the right hip swings forward fastest, at phase 0.
    assert int(cycle.angles[:, KNEE].argmax()) in {*range(6), *range(PHASES - 6, PHASES)}


def test_root_series_has_the_form_a_gait_asks_for(subject):
    """Rows 1, cos p, sin p, ...; six columns; no steady offset in x and y; y, roll and yaw are odd."""
    series = torch.tensor(gait_cycle(synthetic(subject, 0.93, 2.9), "walk").gait.root_harmonics, dtype=torch.float64)
    assert series.shape[1] == 6
    assert series.shape[0] % 2 == 1
    assert series[0, :2].abs().max() == 0
    phase = cycle_phase()[:7]
    now, later = evaluate_series(series, phase), evaluate_series(series, phase + math.pi)
    signs = torch.tensor((1.0, -1.0, 1.0, -1.0, 1.0, -1.0), dtype=torch.float64)
    torch.testing.assert_close(later, now * signs, atol=1e-9, rtol=0)


def test_a_sloping_floor_is_levelled(subject):
    """A path rising by a tenth comes out level, along x, and the pelvis is pitched by the slope (down: positive)."""
    flat = synthetic(subject, 0.93, 2.9, speed=40.0)
    rising = synthetic(subject, 0.93, 2.9, speed=40.0, rise=4.0)
    level = straighten(rising, 0.93)
    length = (level.root_position[-1] - level.root_position[0]).tolist()
    assert abs(length[2]) < 1e-6
    assert length[0] == pytest.approx((rising.root_position[-1] - rising.root_position[0]).norm().item(), rel=1e-6)
    assert 2 * level.root_rotation[0, 1].item() == pytest.approx(math.atan(0.1), rel=0.01)
    torch.testing.assert_close(straighten(flat, 0.93).root_rotation, flat.root_rotation, atol=1e-9, rtol=0)


def test_a_course_to_the_left_is_turned_to_x(subject):
    """A walk turned by 0.5 rad about the vertical straightens to what it was."""
    straight = synthetic(subject, 0.93, 2.9)
    turn = rotations.about_z(torch.full((len(straight.angles),), 0.5, dtype=torch.float64))
    turned = replace(
        straight,
        root_position=rotations.rotate(turn, straight.root_position),
        root_rotation=rotations.multiply(turn, straight.root_rotation),
    )
    back = straighten(turned, 0.93)
    torch.testing.assert_close(back.root_position, straight.root_position, atol=1e-6, rtol=0)
    torch.testing.assert_close(back.root_rotation, straight.root_rotation, atol=1e-6, rtol=0)


def test_a_single_wild_frame_goes_and_a_fast_sweep_stays():
    """A 30 degree spike is repaired; a knee sweeping at 700 deg/s and a 2 Hz swing of 50 degrees are untouched."""
    time = torch.arange(120, dtype=torch.float64) / 120
    true = torch.stack((math.radians(700) * time, math.radians(50) * torch.sin(4 * math.pi * time)), dim=1)
    torch.testing.assert_close(remove_glitches(true), true)
    spiked = true.clone()
    spiked[40] += math.radians(30)
    error = (remove_glitches(spiked) - true).abs()
    assert error[40].max() < math.radians(6)
    assert error.sum() == error[40].sum()


@pytest.mark.parametrize(("frequency", "seconds", "swing"), [(0.9, 3.0, 0.0), (0.9, 0.7, 25.0), (0.9, 0.2, 25.0)])
def test_a_clip_without_a_stride_is_refused(subject, frequency, seconds, swing):
    """Standing still, and less than one stride."""
    with pytest.raises(UserError, match="gait shows no stride"):
        stride_frequency(synthetic(subject, frequency, seconds, swing=swing))


def test_noise_is_no_stride(subject):
    """A harmonic fit that explains little of the motion is no gait."""
    motion = synthetic(subject, 0.9, 3.0)
    noise = torch.randn(motion.angles.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    with pytest.raises(UserError, match="shows no stride"):
        stride_frequency(replace(motion, angles=noise))


@pytest.mark.parametrize("clip", CLIPS)
def test_stride_frequency_and_cycle_of_every_clip(mocap, clip):
    """Frequency within 3 percent, slope within 0.4 degrees of the table, stance soles within 1.5 cm of the floor."""
    frequency, slope = CLIPS[clip]
    subject = clip[:2]
    motion = retargeted(mocap / subject / f"{subject}.asf", mocap / subject / f"{clip}.amc")
    cycle = gait_cycle(motion, "gait")
    assert cycle.gait.frequency == pytest.approx(frequency, rel=0.03)
    turn = rotations.multiply(
        straighten(motion, frequency).root_rotation[0], rotations.conjugate(motion.root_rotation[0])
    )
    course = rotations.rotate(rotations.conjugate(turn), turn.new_tensor((1.0, 0.0, 0.0)))
    assert math.degrees(math.asin(course[2])) == pytest.approx(slope, abs=0.4)
    series = torch.tensor(cycle.gait.root_harmonics, dtype=torch.float64)
    lowest = cycle_sole_heights(evaluate_series(series, cycle_phase()), cycle.angles).amin(dim=-1)
    assert lowest.min() > -0.015
    assert lowest.quantile(0.3) < 0.01


def test_the_default_pair_walks_on_the_floor_and_the_run_leaves_it(mocap):
    """35_08's lowest sole stays within 1.2 cm of the floor all along; 35_17 flies; arms swing against the legs."""
    folder = mocap / "35"
    cycles = {
        name: gait_cycle(retargeted(folder / "35.asf", folder / f"35_{clip}.amc", folder / "35_08.amc"), name)
        for name, clip in (("walk", "08"), ("run", "17"))
    }
    heights = {}
    for name, cycle in cycles.items():
        series = torch.tensor(cycle.gait.root_harmonics, dtype=torch.float64)
        heights[name] = cycle_sole_heights(evaluate_series(series, cycle_phase()), cycle.angles).amin(dim=-1)
        arm = cycle.angles[:, joint_index("right_shoulder_y")]
        leg = cycle.angles[:, RIGHT_HIP]
        assert torch.corrcoef(torch.stack((arm, leg)))[0, 1] < -0.5
    assert heights["walk"].abs().max() < 0.012
    assert heights["run"].max() > 0.03
    assert cycles["walk"].gait.speed == pytest.approx(1.20 * 0.952, rel=0.03)
    assert cycles["run"].gait.speed == pytest.approx(3.18 * 0.952, rel=0.03)
