"""The left-right mirror, y -> -y, of everything that is measured on the humanoid."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import torch

from aicpg_newton.device import MadeOnce
from aicpg_newton.robot.humanoid import JOINT_NAMES, LINK_NAMES


class Mirror(NamedTuple):
    """How a row of numbers changes in the mirror: ``mirrored[i] = sign[i] * original[permutation[i]]``."""

    permutation: tuple[int, ...]
    sign: tuple[float, ...]

    @property
    def size(self) -> int:
        """Number of numbers."""
        return len(self.permutation)

    def __call__(self, values: torch.Tensor) -> torch.Tensor:
        """The mirror image of values, shape [..., size]; mirroring twice is the identity."""
        permutation, sign = _tensors(self, values.device, values.dtype)
        return values[..., permutation] * sign


@MadeOnce
def _tensors(mirror: Mirror, device: torch.device, dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor]:
    """Permutation and sign on a device, once: constants made anew each time would have a GPU wait for the host."""
    return torch.tensor(mirror.permutation, device=device), torch.tensor(mirror.sign, device=device, dtype=dtype)


def joined(parts: Iterable[Mirror]) -> Mirror:
    """The mirror of rows that are put one behind the other."""
    permutation: list[int] = []
    sign: list[float] = []
    for part in parts:
        start = len(permutation)
        permutation += [start + index for index in part.permutation]
        sign += part.sign
    return Mirror(tuple(permutation), tuple(sign))


def _other_side(name: str) -> str:
    if name.startswith("right_"):
        return "left_" + name.removeprefix("right_")
    return "right_" + name.removeprefix("left_") if name.startswith("left_") else name


EVEN = Mirror((0,), (1.0,))
"""A single number that stays as it is: a height, a pitch, the value of a state."""

ODD = Mirror((0,), (-1.0,))
"""A single number that turns its sign: a roll, a yaw."""

VECTOR = Mirror((0, 1, 2), (1.0, -1.0, 1.0))
"""Positions, velocities and forces: x, y, z."""

AXIAL = Mirror((0, 1, 2), (-1.0, 1.0, -1.0))
"""Angular velocities and moments: x, y, z."""

VECTORS_OF_SIDES = Mirror((3, 4, 5, 0, 1, 2), VECTOR.sign * 2)
"""A vector of the right side and one of the left, which swap."""

AXIALS_OF_SIDES = Mirror((3, 4, 5, 0, 1, 2), AXIAL.sign * 2)
"""The same of angular velocities or moments."""

JOINTS = Mirror(
    tuple(JOINT_NAMES.index(_other_side(name)) for name in JOINT_NAMES),
    tuple(-1.0 if name.endswith(("_x", "_z")) else 1.0 for name in JOINT_NAMES),
)
"""Angles, velocities and torques of the 28 joints: those about x and z turn around, those about y do not."""

LINKS = tuple(LINK_NAMES.index(_other_side(name)) for name in LINK_NAMES)
"""Permutation of the 13 links; the position of each is a :data:`VECTOR`."""
