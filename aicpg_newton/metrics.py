"""Measures of a gait (paper, Sec. II-C) as pure functions of trajectories.

Trajectories begin with the time axis, one entry per control step, then the environments: ``[time, num_envs, ...]``.
``valid`` marks the steps that count, shape [time, num_envs]; where it marks none, a measure is NaN. Every environment
is judged by itself, so no value depends on how many there are. Feet are ordered right, left.
"""

from __future__ import annotations

import math

import torch

from aicpg_newton import rotations
from aicpg_newton.cpg import CONTROL_DT, CONTROL_RATE
from aicpg_newton.humanoid import GRAVITY, JOINT_NAMES, LEG_LENGTH, MIRROR_PERMUTATION, MIRROR_SIGN, TOTAL_MASS
from aicpg_newton.terrain import Terrain

CONTACT_FORCE = 0.05 * TOTAL_MASS * GRAVITY
"""A foot that carries more than this is on the ground [N]. 5 % of body weight, 24 N: the level used with force plates
(20 to 50 N), more than twice the weight of a foot, and far less than the load of any real support."""

SLOWEST_SPEED = 0.1
"""Below this mean forward speed [m/s] there is no transport, and its cost is not defined."""

SMALLEST_ANGLE = math.radians(1.0)
"""Least denominator of the symmetry index [rad]: joints within a degree of zero are compared with a degree."""

SOLE_GRID = (13, 7)
"""Points along and across a sole, 15 mm apart: an edge of the terrain between them is missed by a millimetre or two."""

_LONGEST_BOUNCE = 3  # steps in the air (0.05 s) that do not end a stance
_SHORTEST_STANCE = 6  # steps on the ground (0.1 s); less is a scuff of the swinging foot

_RIGHT = [index for index, name in enumerate(JOINT_NAMES) if name.startswith("right_")]
_LEFT = [MIRROR_PERMUTATION[index] for index in _RIGHT]
_SIGN = [MIRROR_SIGN[index] for index in _RIGHT]


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


def froude_number(speed: torch.Tensor) -> torch.Tensor:
    """Fr = v^2 / (g L) (Eq. 11, dimensionless) of forward speeds [m/s], any shape; L = 0.855 m."""
    return speed.square() / (GRAVITY * LEG_LENGTH)


def mechanical_power(joint_torque: torch.Tensor, joint_velocity: torch.Tensor) -> torch.Tensor:
    """Sum over joints of |torque x velocity| [W] (numerator of Eq. 12).

    Args:
        joint_torque: Motor torque [N m], shape [..., 28].
        joint_velocity: Joint velocity [rad/s], shape [..., 28].

    Returns:
        Shape [...]; braking costs as much as driving.
    """
    return (joint_torque * joint_velocity).abs().sum(dim=-1)


def cost_of_transport(power: torch.Tensor, speed: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """CoT = sum_t p / (m g sum_t v) (Eq. 12, dimensionless).

    Args:
        power: :func:`mechanical_power` [W], shape [time, num_envs].
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


def feet_on_ground(foot_force: torch.Tensor) -> torch.Tensor:
    """Whether each foot bears more than :data:`CONTACT_FORCE`, shape [..., 2, 3] [N] to [..., 2]."""
    return foot_force[..., 2] > CONTACT_FORCE


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


def touch_downs(contact: torch.Tensor) -> torch.Tensor:
    """Steps at which feet land after a swing; bool, shape as ``contact``.

    Bounces of up to 0.05 s are filled in, and contacts that are then shorter than 0.1 s left out as scuffs: trained
    gaits drag a toe early in the swing, up to five steps long, which would make two strides of one.

    Args:
        contact: Whether feet are on the ground, bool, shape [time, ...].
    """
    longer = torch.cat((contact, contact.new_zeros(_LONGEST_BOUNCE, *contact.shape[1:])))
    closed = _throughout(_lately(longer, _LONGEST_BOUNCE), _LONGEST_BOUNCE)[: len(contact)]
    stance = _lately(_throughout(closed, _SHORTEST_STANCE - 1), _SHORTEST_STANCE - 1)
    # A foot that is down at the start has not landed; nothing is known of the time before.
    before = torch.cat((stance.new_ones(1, *stance.shape[1:]), stance[:-1]))
    return stance & ~before


def _lately(mask: torch.Tensor, steps: int) -> torch.Tensor:
    """Whether the mask holds now or held within the last steps, shape [time, ...]."""
    padded = torch.cat((mask.new_zeros(steps, *mask.shape[1:]), mask))
    return torch.stack([padded[i : i + len(mask)] for i in range(steps + 1)]).any(dim=0)


def _throughout(mask: torch.Tensor, steps: int) -> torch.Tensor:
    """Whether the mask holds now and in all of the next steps, shape [time, ...]."""
    padded = torch.cat((mask, mask.new_zeros(steps, *mask.shape[1:])))
    return torch.stack([padded[i : i + len(mask)] for i in range(steps + 1)]).all(dim=0)


def whole_strides(contact: torch.Tensor, valid: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Steps from a foot's first touch-down up to its last, and the number of strides in between.

    Args:
        contact: Whether a foot is on the ground, bool, shape [time, ...].
        valid: Steps that count, one stretch for each environment; bool, shape [time, ...].

    Returns:
        Bool, shape [time, ...], and number of strides, shape [...].
    """
    landed = (touch_downs(contact) & valid).long()
    so_far = landed.cumsum(dim=0)
    strides = (landed.sum(dim=0) - 1).clamp(min=0)
    return (so_far >= 1) & (so_far <= strides), strides


def stride_frequency(contact: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """Strides per second [Hz] from the touch-downs of both feet.

    Args:
        contact: Whether each foot is on the ground, bool, shape [time, num_envs, 2].
        valid: Steps that count, one stretch for each environment; shape [time, num_envs].

    Returns:
        Shape [num_envs]; NaN where neither foot makes a whole stride.
    """
    inside, strides = whole_strides(contact, valid.unsqueeze(2).expand_as(contact))
    return CONTROL_RATE * strides.sum(dim=1) / inside.sum(dim=(0, 2))


def duty_factor(contact: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """Share of its whole strides that a foot is on the ground, mean of both feet; arguments as above, [num_envs]."""
    inside, _ = whole_strides(contact, valid.unsqueeze(2).expand_as(contact))
    return ((contact & inside).sum(dim=0) / inside.sum(dim=0)).mean(dim=1)


def flight_ratio(contact: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """Share of whole gait cycles with both feet off the ground (paper, Sec. III-A), shape [num_envs].

    A cycle begins when the right foot lands. Arguments as for :func:`stride_frequency`.
    """
    inside, strides = whole_strides(contact[..., 0], valid)
    ratio = (inside & ~contact.any(dim=2)).sum(dim=0) / inside.sum(dim=0)
    return torch.where(strides > 0, ratio, math.nan)


def flight_share_of_strides(contact: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """Share of the right foot's whole strides that hold a flight phase, shape [num_envs]; arguments as above."""
    inside, strides = whole_strides(contact[..., 0], valid)
    number = (touch_downs(contact[..., 0]) & valid).long().cumsum(dim=0)
    flying = inside & ~contact.any(dim=2)
    with_flight = torch.stack(
        [(flying & (number == stride)).any(dim=0) for stride in range(1, int(strides.max()) + 1)]
        or [torch.zeros_like(strides, dtype=torch.bool)]
    )
    return with_flight.sum(dim=0) / strides


def falls_per_minute(fallen: torch.Tensor) -> torch.Tensor:
    """Falls per minute of simulated time, shape [time, num_envs] (bool, one step per fall) to [num_envs]."""
    return fallen.sum(dim=0) * 60.0 / (len(fallen) * CONTROL_DT)
