"""From a retargeted clip to one closed, symmetric cycle of the gait, and its stride frequency.

Short clips hold only one to three strides and are never periodic, so the frequency comes from a harmonic fit (an FFT
bin of a 1.2 s clip is 0.8 Hz wide), and the cycle averages whole strides and their half-stride mirror images.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import Gait, fourier_basis
from aicpg_newton.motion.acclaim import FRAME_RATE
from aicpg_newton.motion.retarget import RetargetedMotion, frame_times
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import joint_index
from aicpg_newton.robot.kinematics import sole_heights
from aicpg_newton.robot.mirror import JOINTS

PHASES = 256
"""Samples of a cycle over one stride."""

HARMONICS = 8
"""Harmonics kept of the joint angles: 7 Hz in the walk, 11 Hz in the run; beyond is marker noise."""

ROOT_HARMONICS = 4
"""Harmonics kept of the pelvis motion."""

_LEG_JOINTS = [joint_index(f"{side}_{joint}") for side in ("right", "left") for joint in ("hip_y", "knee")]
_RIGHT_HIP, _LEFT_HIP = joint_index("right_hip_y"), joint_index("left_hip_y")
_SLOWEST, _FASTEST = 0.3, 3.0  # stride frequencies of people [Hz]
_LEAST_SPEED = 0.2  # [m/s]
_STEEPEST, _SIDEWAYS, _MOST_TURN = 15.0, 45.0, 20.0  # [deg]
_MOST_SLIDE = 0.12  # of a stance foot, as a share of the pelvis's speed; of CMU's clips at most 0.071
_STANDING = 0.4  # below this share of the fast frames' speed the subject stands, or is about to
_STEP = 0.5  # within this time speed is even [s]
_SHORTEST_STAND = 0.1  # beyond what such a window smooths [s]
_GLITCH = math.radians(6.0)
_ROOT_MIRROR = (1.0, -1.0, 1.0, -1.0, 1.0, -1.0)  # x, y, z, roll, pitch, yaw under a reflection in y


@dataclass(frozen=True)
class GaitCycle:
    """One stride of a gait, what S learns."""

    gait: Gait
    angles: torch.Tensor
    """Joint angles [rad] at evenly spaced phases from 0, shape [samples, 28]."""


def remove_glitches(values: torch.Tensor) -> torch.Tensor:
    """Replace frames that jump away from their neighbourhood by its median.

    A frame is a glitch where it lies more than 6 degrees from the median of the seven frames around it. A median leaves
    a steady sweep alone however fast it is, and people do not turn a joint round by 6 degrees within 25 ms. The
    first and last frame have no neighbourhood and stay.

    Args:
        values: Angles [rad], shape [frames, channels].

    Returns:
        The repaired angles, shape [frames, channels].
    """
    around = torch.cat((values[:1].expand(3, -1), values, values[-1:].expand(3, -1))).unfold(0, 7, 1)
    median = around.median(dim=-1).values
    return torch.where((values - median).abs() > _GLITCH, median, values)


def fourier_series(values: torch.Tensor, harmonics: int) -> torch.Tensor:
    """Coefficients of 1, cos p, sin p, ... of a cycle, shape [samples, channels] to [2 harmonics + 1, channels]."""
    basis = fourier_basis(torch.arange(len(values), dtype=values.dtype) * (2 * math.pi / len(values)), harmonics)
    return torch.linalg.lstsq(basis, values).solution


def evaluate_series(coefficients: torch.Tensor, phase: torch.Tensor) -> torch.Tensor:
    """A Fourier series at phases [rad], shapes [2 harmonics + 1, channels] and [samples] to [samples, channels]."""
    return fourier_basis(phase, (len(coefficients) - 1) // 2) @ coefficients


def _seed_frequency(angles: torch.Tensor) -> float:
    """Highest peak of the windowed, zero-padded spectrum of left-minus-right hip flexion [Hz]."""
    swing = angles[:, _RIGHT_HIP] - angles[:, _LEFT_HIP]
    time = frame_times(len(swing))
    trend = torch.stack((torch.ones_like(time), time), dim=1)
    swing = swing - trend @ torch.linalg.lstsq(trend, swing.unsqueeze(1)).solution.squeeze(1)
    window = torch.hann_window(len(swing), periodic=False, dtype=swing.dtype)
    length = 1 << 14
    spectrum = torch.fft.rfft(swing * window, n=length).abs()
    frequencies = torch.fft.rfftfreq(length, 1.0 / FRAME_RATE, dtype=swing.dtype)
    spectrum[(frequencies < _SLOWEST) | (frequencies > _FASTEST)] = 0.0
    return float(frequencies[spectrum.argmax()])


def _gait_basis(frames: int, frequency: float, harmonics: int) -> torch.Tensor:
    """Harmonics of a stride frequency [Hz] and, in the last column, time [s]; shape [frames, 2 harmonics + 2]."""
    time = frame_times(frames)
    return torch.cat((fourier_basis(2 * math.pi * frequency * time, harmonics), time.unsqueeze(-1)), dim=-1)


def _steady_velocity(path: torch.Tensor, frequency: float) -> torch.Tensor:
    """Mean velocity [m/s] of a path, wherever in a stride the clip begins and ends, shapes [frames, 3] to [3]."""
    return torch.linalg.lstsq(_gait_basis(len(path), frequency, 2), path).solution[-1]


def _harmonic_residual(angles: torch.Tensor, frequency: float) -> float:
    """Square of the angles left by a drift and four harmonics of one frequency, mean of frames, sum of channels."""
    orthonormal = torch.linalg.qr(_gait_basis(len(angles), frequency, 4)).Q
    return float((angles - orthonormal @ (orthonormal.T @ angles)).square().mean(dim=0).sum())


def stride_frequency(motion: RetargetedMotion) -> float:
    """Stride frequency [Hz]: FFT for a seed, then the least-squares harmonic fit of both hips and knees around it.

    Args:
        motion: A clip with at least one stride.

    Raises:
        UserError: The clip is shorter than a stride or shows no rhythm of the legs.
    """
    angles = remove_glitches(motion.angles)
    legs = angles[:, _LEG_JOINTS]
    duration = len(legs) / FRAME_RATE
    hopeless = f"{motion.source} shows no stride: give a straight walk or run of at least one whole stride"
    if duration * _FASTEST < 1.0 or (angles[:, _RIGHT_HIP] - angles[:, _LEFT_HIP]).std() < math.radians(5.0):
        raise UserError(hopeless)
    frequency = _seed_frequency(angles)
    for step in (0.02, 0.002, 0.0002):
        reach = 0.35 if step == 0.02 else 15 * step
        candidates = [frequency * (1 + step * k) for k in range(-round(reach / step), round(reach / step) + 1)]
        residuals = [_harmonic_residual(legs, candidate) for candidate in candidates]
        frequency = candidates[min(range(len(candidates)), key=residuals.__getitem__)]
    explained = 1.0 - _harmonic_residual(legs, frequency) / float(legs.var(dim=0, unbiased=False).sum())
    if explained < 0.8 or duration * frequency < 1.0:
        raise UserError(hopeless)
    return frequency


def straighten(motion: RetargetedMotion, frequency: float) -> RetargetedMotion:
    """Turn and tilt a clip's root so that it moves along x on a level floor.

    Args:
        motion: A clip.
        frequency: Its stride frequency [Hz].

    Returns:
        The clip with its root path along x and no steady rise; joint angles untouched.
    """
    velocity = _steady_velocity(motion.root_position, frequency)
    heading = torch.atan2(velocity[1], velocity[0])
    slope = torch.atan2(velocity[2], velocity[:2].norm())
    # R = Ry(slope) Rz(-heading): a rise is a negative rotation about y.
    turn = rotations.multiply(
        rotations.about_axis(velocity.new_tensor((0.0, 1.0, 0.0)), slope), rotations.about_z(-heading)
    )
    every = turn.expand_as(motion.root_rotation)
    return replace(
        motion,
        root_position=rotations.rotate(every, motion.root_position),
        root_rotation=rotations.multiply(every, motion.root_rotation),
        balls=rotations.rotate(every.unsqueeze(1).expand(-1, 2, 4), motion.balls),
    )


def _speed_over_ground(path: torch.Tensor, frames: int) -> torch.Tensor:
    """Horizontal speed over a window of ``frames`` [m/s], shapes [all frames, ..., 3] to [fewer frames, ...]."""
    level = path[..., :2]
    return (level[frames:] - level[:-frames]).norm(dim=-1) * (FRAME_RATE / frames)


def _check_stands(motion: RetargetedMotion) -> None:
    """Refuse a clip that begins or ends standing, and say how much to cut.

    Raises:
        UserError: It does.
    """
    window = round(_STEP * FRAME_RATE)
    if len(motion.root_position) < 2 * window:
        return
    speed = _speed_over_ground(motion.root_position, window)
    fast = float(speed.quantile(0.9))
    if fast < _LEAST_SPEED:
        return
    moving = (speed >= _STANDING * fast).nonzero().squeeze(1)
    slow = (int(moving[0]), len(speed) - 1 - int(moving[-1]))
    ends = zip(("first", "last"), [frames / FRAME_RATE for frames in slow], strict=True)
    cut = [f"its {name} {time + (1.0 - _STANDING) * _STEP:.1f} s" for name, time in ends if time >= _SHORTEST_STAND]
    if cut:
        raise UserError(f"{motion.source} does not walk or run from end to end; cut {' and '.join(cut)} off the clip")


def _turn(motion: RetargetedMotion, frequency: float) -> float:
    """How far a clip's course turns from its first frame to its last, or in between [deg].

    The larger of how far the pelvis turns and how far the direction of progress over a stride does: a clip may turn and
    turn back, or go round while it faces one way.
    """
    frames = len(motion.angles)
    yaw = np.unwrap(rotations.yaw(motion.root_rotation).numpy())
    steady = torch.linalg.lstsq(_gait_basis(frames, frequency, 2), torch.from_numpy(yaw).unsqueeze(1)).solution
    stride = min(round(FRAME_RATE / frequency), frames - 1)
    progress = motion.root_position[stride:, :2] - motion.root_position[:-stride, :2]
    progress = progress[progress.norm(dim=1) * frequency > _LEAST_SPEED]
    course = np.unwrap(torch.atan2(progress[:, 1], progress[:, 0]).numpy())
    turned = float(np.ptp(course)) if len(course) else 0.0
    return math.degrees(max(abs(float(steady[-1])) * frames / FRAME_RATE, turned))


def _check_stance(motion: RetargetedMotion, speed: float) -> None:
    """Refuse a clip whose feet never stand still on the ground.

    In a quarter of the frames of a walk or a run, and more, the ball of one foot rests.

    Args:
        motion: The clip.
        speed: Its mean speed [m/s].

    Raises:
        UserError: They never do.
    """
    slide = float(_speed_over_ground(motion.balls, 2).amin(dim=1).quantile(0.25))
    if slide > _MOST_SLIDE * speed:
        raise UserError(
            f"the feet of {motion.source} slide over the ground at {slide:.2f} m/s or more while the pelvis goes at"
            f" {speed:.2f} m/s; give a clip over ground, not of a treadmill, whose root position and bones have the"
            " same unit and scale"
        )


def _check_course(motion: RetargetedMotion, frequency: float) -> None:
    """Refuse a clip that stands still, climbs, turns, slides, or goes another way than its pelvis faces.

    Args:
        motion: The clip.
        frequency: Its stride frequency [Hz].

    Raises:
        UserError: It does one of these.
    """
    turn = _turn(motion, frequency)
    if turn > _MOST_TURN:
        raise UserError(
            f"{motion.source} turns by {turn:.0f} degrees; give a clip that goes straight ahead, or cut one"
        )
    velocity = _steady_velocity(motion.root_position, frequency)
    speed = float(velocity.norm())
    if speed < _LEAST_SPEED:
        raise UserError(
            f"{motion.source} does not progress ({speed:.2f} m/s); give a clip over ground, not one of a treadmill"
        )
    slope = math.degrees(math.asin(float(velocity[2]) / speed))
    if abs(slope) > _STEEPEST:
        raise UserError(f"{motion.source} rises by {slope:.0f} degrees; give a clip on a level floor, with y up")
    ahead = rotations.rotate(motion.root_rotation, velocity.new_tensor((1.0, 0.0, 0.0)).expand(len(motion.angles), 3))
    facing = ahead.mean(dim=0)
    cosine = float(torch.nn.functional.cosine_similarity(facing[:2], velocity[:2], dim=0))
    away = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
    if away > _SIDEWAYS:
        raise UserError(
            f"the pelvis of {motion.source} faces {away:.0f} degrees away from where it goes; give a clip that walks or"
            " runs straight forwards"
        )
    _check_stance(motion, speed)


def _average_stride(values: torch.Tensor, frequency: float) -> torch.Tensor:
    """Whole strides from the middle of a clip, averaged and closed, shape [frames, channels] to [PHASES, channels]."""
    period = FRAME_RATE / frequency
    strides = int((len(values) - 1) / period)
    start = 0.5 * (len(values) - 1 - strides * period)
    grid = start + torch.arange(strides * PHASES + 1, dtype=values.dtype) * (period / PHASES)
    low = grid.floor().long().clamp(max=len(values) - 2)
    share = (grid - low).unsqueeze(-1)
    samples = (1 - share) * values[low] + share * values[low + 1]
    # The clip's drift over a stride is taken out as a ramp about the clip's middle: the cycle closes, its mean stays.
    drift = (samples[-1] - samples[0]) / strides
    ramp = (torch.arange(strides * PHASES, dtype=values.dtype) + 0.5) / PHASES - 0.5 * strides
    return (samples[:-1] - ramp.unsqueeze(-1) * drift).reshape(strides, PHASES, -1).mean(dim=0)


def _symmetric(cycle: torch.Tensor, mirrored: torch.Tensor) -> torch.Tensor:
    """Average of a cycle and its mirror image half a stride later, both of shape [PHASES, channels]."""
    return 0.5 * (cycle + mirrored.roll(PHASES // 2, dims=0))


def gait_cycle(motion: RetargetedMotion, name: str) -> GaitCycle:
    """One cycle of a gait from a clip.

    Args:
        motion: The clip.
        name: ``walk`` or ``run``.

    Returns:
        Joint angles over a stride and the gait's facts, without fit errors. Phase 0 is where the fundamental of
        right-minus-left hip flexion crosses zero upwards, and pose(phase + pi) is the mirror image of pose(phase).

    Raises:
        UserError: No stride is found in the clip, or it does not go straight forwards over a level floor throughout.
    """
    _check_stands(motion)
    frequency = stride_frequency(motion)
    _check_course(motion, frequency)
    straight = straighten(motion, frequency)
    velocity = _steady_velocity(straight.root_position, frequency)
    position = straight.root_position - frame_times(len(straight.angles)).unsqueeze(-1) * velocity
    position = (position - position.mean(dim=0)) * motion.leg_ratio
    attitude = torch.stack(rotations.roll_pitch_yaw(straight.root_rotation), dim=-1)

    angles = _average_stride(remove_glitches(straight.angles), frequency)
    root = _average_stride(torch.cat((position, remove_glitches(attitude)), dim=-1), frequency)
    angles = _symmetric(angles, JOINTS(angles))
    root = _symmetric(root, root * root.new_tensor(_ROOT_MIRROR))

    phase = torch.arange(PHASES, dtype=angles.dtype) * (2 * math.pi / PHASES)
    flexion = (angles[:, _LEFT_HIP] - angles[:, _RIGHT_HIP]).unsqueeze(-1)
    _, cosine, sine = fourier_series(flexion, 1).squeeze(-1).tolist()
    start = -math.atan2(cosine, sine)  # a cos p + b sin p = |.| sin(p - start)
    angles = evaluate_series(fourier_series(angles, HARMONICS), phase + start)
    series = fourier_series(evaluate_series(fourier_series(root, ROOT_HARMONICS), phase + start), ROOT_HARMONICS)
    series[0, :2] = 0.0
    series[0, 2] -= _floor_offset(series, angles, phase)
    gait = Gait(
        name, motion.source, frequency, float(velocity[0]) * motion.leg_ratio, tuple(map(tuple, series.tolist()))
    )
    return GaitCycle(gait, angles.float())


def cycle_sole_heights(root: torch.Tensor, angles: torch.Tensor) -> torch.Tensor:
    """Sole heights [m] over a cycle, shape [samples, 2] (right, left).

    Args:
        root: x, y, z [m] and roll, pitch, yaw [rad], shape [samples, 6].
        angles: Joint angles [rad], shape [samples, 28].
    """
    return sole_heights(root[:, :3], root_rotation(root), angles.to(root))


def root_rotation(root: torch.Tensor) -> torch.Tensor:
    """Pelvis rotation (x, y, z, w) of rows x, y, z, roll, pitch, yaw, shape [..., 6] to [..., 4]."""
    return rotations.from_roll_pitch_yaw(*root[..., 3:].unbind(dim=-1))


def _floor_offset(series: torch.Tensor, angles: torch.Tensor, phase: torch.Tensor) -> float:
    """Height by which the cycle must be lowered [m] for its stance soles to lie on the floor."""
    lowest = cycle_sole_heights(evaluate_series(series, phase), angles).amin(dim=-1)
    return float(lowest.quantile(0.25))
