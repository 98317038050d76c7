"""Quaternions as Newton stores them, (x, y, z, w), batched in torch."""

from __future__ import annotations

import torch

_SHORTEST = 1e-20
"""A quaternion whose components are all smaller has no direction."""


def normalised(q: torch.Tensor, otherwise: torch.Tensor) -> torch.Tensor:
    """Unit quaternions of the same rotations, shape [..., 4]; what has length 1 within rounding keeps its bits.

    Args:
        q: Quaternions of any length.
        otherwise: What stands for those of length 0 or with a component that is not finite.
    """
    finite = torch.isfinite(q).all(dim=-1, keepdim=True)
    largest = torch.where(finite, q, 0.0).abs().amax(dim=-1, keepdim=True)
    known = largest > _SHORTEST
    scaled = q / torch.where(known, largest, 1.0)  # so that no square overflows
    unit = scaled / scaled.square().sum(dim=-1, keepdim=True).sqrt()
    is_unit = (q.square().sum(dim=-1, keepdim=True) - 1.0).abs() < 1e-5
    return torch.where(known, torch.where(is_unit, q, unit), otherwise)


def multiply(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Quaternion product a * b (apply b first), shapes [..., 4]."""
    av, aw, bv, bw = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    vector = aw * bv + bw * av + torch.linalg.cross(av, bv)
    scalar = aw * bw - (av * bv).sum(-1, keepdim=True)
    return torch.cat((vector, scalar), dim=-1)


def conjugate(q: torch.Tensor) -> torch.Tensor:
    """Inverse rotation of a unit quaternion, shape [..., 4]."""
    return torch.cat((-q[..., :3], q[..., 3:]), dim=-1)


def rotate(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Vector v turned by q (from q's local frame to the frame q is given in), shapes [..., 4] and [..., 3]."""
    u, w = q[..., :3], q[..., 3:]
    t = 2.0 * torch.linalg.cross(u, v)
    return v + w * t + torch.linalg.cross(u, t)


def angular_velocity(before: torch.Tensor, after: torch.Tensor, duration: float) -> torch.Tensor:
    """Mean angular velocity [rad/s] of a small turn from one rotation to another, shapes [..., 4] to [..., 3].

    In the frame that the rotations are given in; the angle is taken as twice the sine of its half.
    """
    turn = multiply(after, conjugate(before))
    return 2.0 * torch.sign(turn[..., 3:]) * turn[..., :3] / duration


def about_axis(axis: torch.Tensor, angle: torch.Tensor) -> torch.Tensor:
    """Rotation by angle [rad] about a unit axis, shapes [..., 3] and [...]."""
    half = 0.5 * angle.unsqueeze(-1)
    return torch.cat((axis * torch.sin(half), torch.cos(half)), dim=-1)


def from_euler_xyz(angles: torch.Tensor) -> torch.Tensor:
    """Rotation of three intrinsic hinges R = Rx Ry Rz, angles [rad] of shape [..., 3].

    The product of the three quaternions, multiplied out: a quarter of the time of multiplying them.
    """
    half = 0.5 * angles
    (sx, sy, sz), (cx, cy, cz) = torch.sin(half).unbind(-1), torch.cos(half).unbind(-1)
    ss, sc, cs, cc = sx * sy, sx * cy, cx * sy, cx * cy
    return torch.stack((sc * cz + cs * sz, cs * cz - sc * sz, cc * sz + ss * cz, cc * cz - ss * sz), dim=-1)


def roll_pitch_yaw(q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Angles [rad] with R = Rz(yaw) Ry(pitch) Rx(roll), each of shape [...]."""
    x, y, z, w = q.unbind(-1)
    roll = torch.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = torch.asin((2 * (w * y - z * x)).clamp(-1.0, 1.0))
    return roll, pitch, yaw(q)


def from_roll_pitch_yaw(roll: torch.Tensor, pitch: torch.Tensor, yaw: torch.Tensor) -> torch.Tensor:
    """Rotation Rz(yaw) Ry(pitch) Rx(roll), angles [rad] of shape [...]; the inverse of :func:`roll_pitch_yaw`."""
    x, y, z = torch.eye(3, dtype=roll.dtype, device=roll.device).unbind(0)
    shape = (*roll.shape, 3)
    tilt = multiply(about_axis(y.expand(shape), pitch), about_axis(x.expand(shape), roll))
    return multiply(about_axis(z.expand(shape), yaw), tilt)


def about_z(angle: torch.Tensor) -> torch.Tensor:
    """Rotation by angle [rad] about the vertical, shape [...] to [..., 4]."""
    zero = torch.zeros_like(angle)
    return torch.stack((zero, zero, torch.sin(0.5 * angle), torch.cos(0.5 * angle)), dim=-1)


def up_axis(q: torch.Tensor) -> torch.Tensor:
    """The body's z axis in the world, shape [..., 3]."""
    x, y, z, w = q.unbind(-1)
    return torch.stack((2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)), dim=-1)


def yaw(q: torch.Tensor) -> torch.Tensor:
    """Third of :func:`roll_pitch_yaw`, shape [...]."""
    x, y, z, w = q.unbind(-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
