"""Measures of a gait (paper, Sec. II-C) as pure functions of trajectories.

Trajectories begin with the time axis, one entry per control step, then the environments: ``[time, num_envs, ...]``.
``valid`` marks the steps that count, shape [time, num_envs]; where it marks none, a measure is NaN. Every environment
is judged by itself, so no value depends on how many there are. Feet are ordered right, left.
"""

from __future__ import annotations

import math

import torch

from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import CONTROL_DT, GRAVITY, JOINT_NAMES, TOTAL_MASS
from aicpg_newton.robot.mirror import JOINTS

SLOWEST_SPEED = 0.1
"""Below this mean forward speed [m/s] there is no transport, and its cost is not defined."""

SMALLEST_ANGLE = math.radians(1.0)
"""Least denominator of the symmetry index [rad]: joints within a degree of zero are compared with a degree."""

SOLE_GRID = (13, 7)
"""Points along and across a sole, 15 mm apart: an edge of the terrain between them is missed by a millimetre or two."""

_LONGEST_BOUNCE = 3  # steps in the air (0.05 s) that do not end a stance
_SHORTEST_STANCE = 6  # steps on the ground (0.1 s); less is a scuff of the swinging foot

_STRIDE_STEPS = (10, 120)
"""Shortest and longest stride that is looked for [control steps]: 6 to 0.5 a second."""

_SAME_AGAIN = 0.5
"""Least autocorrelation of the legs' motion one stride apart; below it there is no rhythm."""

_NEARLY_AS_GOOD = 0.9
"""Of the lags at which the motion repeats, strides are the shortest that is as good as the best but for this factor."""

_NEXT_LANDING = 0.75
"""A foot that comes down sooner after it landed than this share of a stride has not landed again."""

_LEGS = [JOINT_NAMES.index(f"{side}_{joint}") for side in ("right", "left") for joint in ("hip_y", "knee")]

_RIGHT = [index for index, name in enumerate(JOINT_NAMES) if name.startswith("right_")]
_LEFT = [JOINTS.permutation[index] for index in _RIGHT]
_SIGN = [JOINTS.sign[index] for index in _RIGHT]


def masked_mean(values: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """Mean over the valid steps, shape [time, num_envs] to [num_envs]; NaN where there are none."""
    total = torch.where(valid, values, 0.0).double().sum(dim=0)
    return (total / valid.sum(dim=0)).float()


def moving_mean(values: torch.Tensor, valid: torch.Tensor, window: int) -> torch.Tensor:
    """Mean over a window centred on each step, shape [time, num_envs]; NaN unless the whole window is valid.

    Args:
        values: What to average, shape [time, num_envs].
        valid: Steps that count, shape [time, num_envs].
        window: Steps in the window, an even number; the window of step t holds t - window / 2 to t + window / 2 - 1.
    """
    result = torch.full(values.shape, math.nan, device=values.device)
    if len(values) < window:
        return result
    start = values.new_zeros((1, values.shape[1]), dtype=torch.double)
    total = torch.cat((start, torch.where(valid, values, 0.0).double().cumsum(dim=0)))
    count = torch.cat((start, valid.double().cumsum(dim=0)))
    sums, counts = (each[window:] - each[:-window] for each in (total, count))
    half = window // 2
    result[half : half + len(sums)] = torch.where(counts == window, sums / window, math.nan).float()
    return result


def cost_of_transport(power: torch.Tensor, speed: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """CoT = sum_t p / (m g sum_t v) (Eq. 12, dimensionless).

    Args:
        power: Sum over joints of driving and braking power (:class:`~aicpg_newton.engines.interface.StepMeasures`) [W],
            shape [time, num_envs]; braking costs as much as driving.
        speed: Velocity of the centre of mass in the target direction [m/s], shape [time, num_envs].
        valid: Steps that count, shape [time, num_envs].

    Returns:
        Shape [num_envs]; NaN where the mean speed is under :data:`SLOWEST_SPEED`.
    """
    mean_speed = masked_mean(speed, valid)
    cost = masked_mean(power, valid) / (TOTAL_MASS * GRAVITY * mean_speed)
    return torch.where(mean_speed >= SLOWEST_SPEED, cost, math.nan)


def balance_index(root_rotation: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """BI: mean of z_global . z_pelvis (Eq. 13); 1 is upright throughout.

    Args:
        root_rotation: Pelvis rotation (x, y, z, w), shape [time, num_envs, 4].
        valid: Steps that count, shape [time, num_envs].
    """
    return masked_mean(rotations.up_axis(root_rotation)[..., 2], valid)


def symmetry_index(joint_position: torch.Tensor, valid: torch.Tensor, lag: torch.Tensor) -> torch.Tensor:
    """SI (Eq. 10) in a form that is defined everywhere: 0 is symmetric, 2 is one side still or both opposed.

    SI = 1/J sum_j [sum_t |X_R(t, j) - X_L(t + lag, j)|] / [sum_t 0.5 (|X_R(t, j)| + |X_L(t + lag, j)|)]

    over the 11 pairs of limb joints, with the left side's angles mirrored. It departs from the print in three ways:

    - *Magnitudes in the denominator.* The printed sum X_R + X_L is signed: it vanishes and turns negative wherever the
      two angles are opposed, so that single steps decide the value.
    - *Sums over time before the division.* An angle that passes zero on both sides would make 0/0 of one step. Over
      the trial a joint's mean magnitude is never small unless it does not move; :data:`SMALLEST_ANGLE` bounds it.
    - *A lag.* At the same instant (lag 0, as printed) a perfect walk scores badly, because its legs are half a stride
      apart, and hopping on both legs scores 0. With half a stride of lag, 0 means that each side does what the other
      did half a stride before, which is what a symmetric gait is.

    Args:
        joint_position: Joint angles [rad], shape [time, num_envs, 28].
        valid: Steps that count, shape [time, num_envs]; both instants of a comparison must be valid.
        lag: Steps from the right side's instant to the left side's, at least 0 and not necessarily whole, shape
            [num_envs]; NaN gives NaN.

    Returns:
        Shape [num_envs].
    """
    right = joint_position[..., _RIGHT]
    left = joint_position[..., _LEFT] * joint_position.new_tensor(_SIGN)
    known = torch.isfinite(lag)
    steps = torch.arange(len(right), device=right.device).unsqueeze(1) + torch.where(known, lag, 0.0)
    before = steps.floor().long()
    inside = before + 1 < len(right)
    first, second = before.clamp(max=len(right) - 1), (before + 1).clamp(max=len(right) - 1)
    share = (steps - before).unsqueeze(2)
    rows = [index.unsqueeze(2).expand_as(left) for index in (first, second)]
    later = (1 - share) * left.gather(0, rows[0]) + share * left.gather(0, rows[1])
    compared = valid & inside & valid.gather(0, first) & valid.gather(0, second)

    def total(values: torch.Tensor) -> torch.Tensor:
        return torch.where(compared.unsqueeze(2), values, 0.0).sum(dim=0)

    count = compared.sum(dim=0)
    smallest = SMALLEST_ANGLE * count.clamp(min=1).unsqueeze(1)
    ratio = total((right - later).abs()) / torch.maximum(total(0.5 * (right.abs() + later.abs())), smallest)
    return torch.where(known & (count > 0), ratio.mean(dim=1), math.nan)


def sole_clearance(corners: torch.Tensor, terrain: Terrain | None) -> torch.Tensor:
    """Height of a sole's lowest point above the ground [m], negative where the sole is in it.

    Heights are compared at :data:`SOLE_GRID` points all over the sole: an edge of the terrain may come up in the middle
    of a foot whose corners are clear of it.

    Args:
        corners: World positions of the sole's corners [m], heel right, heel left, toe right, toe left, as from
            :func:`kinematics.sole_corners`, shape [..., 4, 3].
        terrain: The ground; None for the plane at height 0.

    Returns:
        Shape [...].
    """
    along, across = (torch.linspace(0.0, 1.0, count).to(corners) for count in SOLE_GRID)
    share = torch.stack((1.0 - along, along), dim=1)[:, None, :, None]
    share = share * torch.stack((1.0 - across, across), dim=1)[None, :, None, :]
    points = torch.einsum("pc,...ck->...pk", share.flatten(2).flatten(0, 1), corners)
    ground = 0.0 if terrain is None else terrain.height(points)
    return (points[..., 2] - ground).amin(dim=-1)


def sole_penetration(
    clearance: torch.Tensor, contact: torch.Tensor, valid: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """How deep feet in contact are in the ground and how high they are above it [m]; 0 and 0 look right.

    Args:
        clearance: :func:`sole_clearance` of both feet [m], shape [time, num_envs, 2].
        contact: Whether each foot is on the ground, bool, shape [time, num_envs, 2].
        valid: Steps that count, shape [time, num_envs].

    Returns:
        Mean depth of the deepest point, and mean height of the lowest, over both feet and all steps in which they are
        in contact, each of shape [num_envs]; NaN where no foot ever is.
    """
    known = (contact & valid.unsqueeze(2)).transpose(1, 2).flatten(0, 1)
    gap = clearance.transpose(1, 2).flatten(0, 1)
    return masked_mean((-gap).clamp_min(0.0), known), masked_mean(gap.clamp_min(0.0), known)


def stride_period(joint_position: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """Control steps of a stride: the shortest time after which hips and knees do the same again, shape [num_envs].

    It is read off the motion, as trained gaits drag a toe and scuff, and touch-downs of such feet count strides twice.

    Args:
        joint_position: Joint angles [rad], shape [time, num_envs, 28].
        valid: Steps that count, one stretch of time for each environment; shape [time, num_envs].

    Returns:
        Steps, not necessarily whole; NaN where nothing repeats, or in a stretch shorter than one and a half strides.
    """
    angles, counted = joint_position[..., _LEGS], valid.unsqueeze(2)
    mean = torch.where(counted, angles, 0.0).sum(dim=0) / valid.sum(dim=0).clamp(min=1).unsqueeze(1)
    motion = torch.where(counted, angles - mean, 0.0)
    likeness = []
    for lag in range(_STRIDE_STEPS[0] - 1, _STRIDE_STEPS[1] + 2):
        if 3 * lag > 2 * len(motion):
            likeness.append(motion.new_zeros(motion.shape[1]))
            continue
        both = (valid[lag:] & valid[:-lag]).unsqueeze(2)
        before, after = (torch.where(both, part, 0.0) for part in (motion[:-lag], motion[lag:]))
        energy = before.square().sum(dim=(0, 2)) * after.square().sum(dim=(0, 2))
        alike = (before * after).sum(dim=(0, 2)) / energy.sqrt().clamp(min=1e-9)
        likeness.append(torch.where(2 * both.sum(dim=(0, 2)) >= lag, alike, 0.0))
    shorter, here, longer = torch.stack(likeness).unfold(0, 3, 1).unbind(dim=2)
    peak = torch.where((here > shorter) & (here >= longer), here, 0.0)
    best = peak.amax(dim=0)
    first = (peak >= _NEARLY_AS_GOOD * best).long().argmax(dim=0, keepdim=True)
    low, top, high = (each.gather(0, first).squeeze(0) for each in (shorter, here, longer))
    between = 0.5 * (low - high) / (low - 2.0 * top + high)  # vertex of the parabola through the peak
    return torch.where(best >= _SAME_AGAIN, _STRIDE_STEPS[0] + first.squeeze(0) + between, math.nan)


def touch_downs(contact: torch.Tensor, period: torch.Tensor) -> torch.Tensor:
    """Steps at which feet land after a swing; bool, shape as ``contact``.

    Bounces of up to 0.05 s are filled in, contacts that are then shorter than 0.1 s are left out as scuffs, and so is
    whatever comes less than three quarters of a stride after a landing: trained gaits drag a toe in the swing.

    Args:
        contact: Whether feet are on the ground, bool, shape [time, num_envs, ...].
        period: Steps of a stride, shape [num_envs]; where it is NaN, landings may follow one another at once.
    """
    longer = torch.cat((contact, contact.new_zeros(_LONGEST_BOUNCE, *contact.shape[1:])))
    closed = _throughout(_lately(longer, _LONGEST_BOUNCE), _LONGEST_BOUNCE)[: len(contact)]
    stance = _lately(_throughout(closed, _SHORTEST_STANCE - 1), _SHORTEST_STANCE - 1)
    # A foot that is down at the start has not landed; nothing is known of the time before.
    before = torch.cat((stance.new_ones(1, *stance.shape[1:]), stance[:-1]))
    landed = stance & ~before
    apart = (_NEXT_LANDING * period).nan_to_num(0.0).reshape(-1, *(1,) * (contact.dim() - 2))
    last = torch.full(landed.shape[1:], -math.inf, device=landed.device)
    for step, each in enumerate(landed):
        each &= step - last >= apart
        last = torch.where(each, float(step), last)
    return landed


def _lately(mask: torch.Tensor, steps: int) -> torch.Tensor:
    """Whether the mask holds now or held within the last steps, shape [time, ...]."""
    padded = torch.cat((mask.new_zeros(steps, *mask.shape[1:]), mask))
    return torch.stack([padded[i : i + len(mask)] for i in range(steps + 1)]).any(dim=0)


def _throughout(mask: torch.Tensor, steps: int) -> torch.Tensor:
    """Whether the mask holds now and in all of the next steps, shape [time, ...]."""
    padded = torch.cat((mask, mask.new_zeros(steps, *mask.shape[1:])))
    return torch.stack([padded[i : i + len(mask)] for i in range(steps + 1)]).all(dim=0)


def whole_strides(
    contact: torch.Tensor, valid: torch.Tensor, period: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Strides of a foot, from its first touch-down up to its last.

    Args:
        contact: Whether a foot is on the ground, bool, shape [time, num_envs, ...].
        valid: Steps that count, one stretch for each environment; bool, same shape.
        period: Steps of a stride, shape [num_envs].

    Returns:
        Number of the stride that each step is part of, from 1, and 0 outside them, shape [time, num_envs, ...]; and how
        many there are, shape [num_envs, ...].
    """
    landed = (touch_downs(contact, period) & valid).long()
    so_far = landed.cumsum(dim=0)
    strides = (landed.sum(dim=0) - 1).clamp(min=0)
    return torch.where(so_far <= strides, so_far, 0), strides


def duty_factor(
    support: torch.Tensor, contact: torch.Tensor, valid: torch.Tensor, period: torch.Tensor
) -> torch.Tensor:
    """Share of its whole strides that a foot is on the ground, mean of both feet.

    Args:
        support: Share of each step that each foot is on the ground, shape [time, num_envs, 2].
        contact: Whether it is, on the mean of the step, bool, same shape; strides are detected from it.
        valid: Steps that count, one stretch for each environment; shape [time, num_envs].
        period: Steps of a stride, :func:`stride_period`, shape [num_envs].

    Returns:
        Shape [num_envs]; NaN where a foot makes no whole stride.
    """
    inside = whole_strides(contact, valid.unsqueeze(2).expand_as(contact), period)[0] > 0
    return (torch.where(inside, support, 0.0).sum(dim=0) / inside.sum(dim=0)).mean(dim=1)


def flight_ratio(
    flight: torch.Tensor, contact: torch.Tensor, valid: torch.Tensor, period: torch.Tensor
) -> torch.Tensor:
    """Share of whole gait cycles with both feet off the ground (paper, Sec. III-A), shape [num_envs].

    A cycle begins when the right foot lands.

    Args:
        flight: Share of each step with both feet off the ground, shape [time, num_envs].
        contact: As for :func:`duty_factor`.
        valid: As for :func:`duty_factor`.
        period: As for :func:`duty_factor`.
    """
    stride, strides = whole_strides(contact[..., 0], valid, period)
    inside = stride > 0
    ratio = torch.where(inside, flight, 0.0).sum(dim=0) / inside.sum(dim=0)
    return torch.where(strides > 0, ratio, math.nan)


def flight_share_of_strides(
    flight: torch.Tensor, contact: torch.Tensor, valid: torch.Tensor, period: torch.Tensor
) -> torch.Tensor:
    """Share of the right foot's whole strides with at least one whole step of flight, shape [num_envs].

    Arguments as for :func:`flight_ratio`.
    """
    stride, strides = whole_strides(contact[..., 0], valid, period)
    flying = torch.where(flight < 1.0 - 1e-6, 0, stride)  # a sum of quarters is not quite one
    with_flight = torch.stack(
        [(flying == number).any(dim=0) for number in range(1, int(strides.max()) + 1)]
        or [torch.zeros_like(strides, dtype=torch.bool)]
    )
    return with_flight.sum(dim=0) / strides


def falls_per_minute(fallen: torch.Tensor) -> torch.Tensor:
    """Falls per minute of simulated time, shape [time, num_envs] (bool, one step per fall) to [num_envs]."""
    return fallen.sum(dim=0) * 60.0 / (len(fallen) * CONTROL_DT)
