"""What a network sees, as a list of blocks, each of which declares values, layout and mirror image in one place."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import torch

from aicpg_newton.env.view import BodyView, View
from aicpg_newton.gait.cpg import pd_torque
from aicpg_newton.robot.mirror import (
    AXIAL,
    AXIALS_OF_SIDES,
    EVEN,
    JOINTS,
    ODD,
    VECTOR,
    VECTORS_OF_SIDES,
    Mirror,
    joined,
)

_View = TypeVar("_View", bound=BodyView)


@dataclass(frozen=True)
class Block(Generic[_View]):
    """One quantity that is seen."""

    name: str
    mirror: Mirror
    """Its left-right mirror image, and with that its size."""
    function: Callable[[_View], torch.Tensor]
    """Its values, shape [..., size]."""


def observe(blocks: Iterable[Block[_View]], view: _View) -> torch.Tensor:
    """All blocks, one behind the other, shape [..., sum of sizes]."""
    return torch.cat([block.function(view) for block in blocks], dim=-1)


def mirror_of(blocks: Iterable[Block]) -> Mirror:
    """Mirror of all blocks, one behind the other."""
    return joined(block.mirror for block in blocks)


def layout(blocks: Iterable[Block]) -> list[list]:
    """Name and size of each block, in order, as plain data."""
    return [[block.name, block.mirror.size] for block in blocks]


def differences(stored: Sequence[Sequence], own: Sequence[Sequence]) -> str:
    """What a checkpoint's layout has that another lacks and the other way round, in words; empty where they agree."""
    if list(map(tuple, stored)) == list(map(tuple, own)):
        return ""
    texts = []
    for title, these, others in (("the checkpoint's", stored, own), ("these", own, stored)):
        extra = [f"{name} ({size})" for name, size in these if [name, size] not in [list(each) for each in others]]
        total = sum(size for _, size in these)
        texts.append(f"{title} {total} numbers" + (f" with {', '.join(extra)}" if extra else ", in another order"))
    return " against ".join(texts)


BODY: tuple[Block[View], ...] = (
    Block("root_height", EVEN, lambda view: view.height.unsqueeze(1)),
    Block("linear_velocity", VECTOR, lambda view: view.in_heading_frame[:, :3]),
    Block("angular_velocity", AXIAL, lambda view: view.in_heading_frame[:, 3:6]),
    # The yaw itself would be the angle to the target once more; the up projection alone has no sign for the pitch.
    Block("pitch", EVEN, lambda view: view.roll_pitch_yaw[1].unsqueeze(1)),
    Block("roll", ODD, lambda view: view.roll_pitch_yaw[0].unsqueeze(1)),
    Block("angle_to_target", ODD, lambda view: view.angle_to_target.unsqueeze(1)),
    Block("up", EVEN, lambda view: view.up.unsqueeze(1)),
    Block("cosine_to_target", EVEN, lambda view: torch.cos(view.angle_to_target).unsqueeze(1)),
    Block("joint_position", JOINTS, lambda view: view.state.joint_position),
    Block("joint_velocity", JOINTS, lambda view: view.state.joint_velocity),
    Block("joint_torque", JOINTS, lambda view: view.state.joint_torque / view.motors.torque_limit),
    Block("foot_force", VECTORS_OF_SIDES, lambda view: view.in_heading_frame[:, 6:12]),
    Block("foot_moment", AXIALS_OF_SIDES, lambda view: view.in_heading_frame[:, 12:18]),
    Block("action_torque", JOINTS, lambda view: view.torque / view.torque_unit),
)
"""What every network sees of its body: 136 numbers (paper, Sec. II-A.2).

Vectors are in the heading frame, torques in units of the joint's limit. ``action_torque`` is what the network asked for
in the last step, tau_r, in units of :attr:`View.torque_unit`.
"""


def _target(view: View) -> torch.Tensor:
    """theta_t [rad]."""
    assert view.target is not None
    return view.target


def _cpg_torque(view: View) -> torch.Tensor:
    """tau_g of Eq. 4, in units of the limit."""
    assert view.target is not None and view.target_velocity is not None
    torque = pd_torque(
        view.target,
        view.target_velocity,
        view.state.joint_position,
        view.state.joint_velocity,
        position_gain=view.motors.position_gain,
        velocity_gain=view.motors.velocity_gain,
    )
    return torque / view.motors.torque_limit


PATTERN: tuple[Block[View], ...] = (
    Block("target", JOINTS, _target),
    Block("cpg_torque", JOINTS, _cpg_torque),
)
"""What a network beside a CPG sees of it: 56 numbers more, 192 in all."""
