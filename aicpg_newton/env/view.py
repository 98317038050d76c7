"""What rewards and observations are made of: one view of a control step, with all that follows from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Self, TypeVar, overload

import torch

from aicpg_newton.engines.interface import BodyState, RobotState
from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.env.commands import Commands
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import BODY_WEIGHT, FOOT_LEVER, Motors

_Value = TypeVar("_Value")


class derived(Generic[_Value]):
    """A property that is computed when first asked for, and once.

    :func:`functools.cached_property` holds a lock in Python 3.11, which :func:`torch.compile` cannot see through.
    """

    def __init__(self, function: Callable[[Any], _Value]) -> None:
        self._function = function
        self._name = function.__name__
        self.__doc__ = function.__doc__

    @overload
    def __get__(self, owner: None, kind: type | None = None) -> Self: ...
    @overload
    def __get__(self, owner: object, kind: type | None = None) -> _Value: ...
    def __get__(self, owner: object | None, kind: type | None = None) -> Any:
        """The value, from the owner's own dictionary after the first time."""
        if owner is None:
            return self
        value = self._function(owner)
        setattr(owner, self._name, value)  # into its dictionary, which goes before a descriptor without __set__
        return value


@dataclass
class BodyView:
    """Bodies at an instant, of any batch shape [...]. What is derived is computed when first asked for, and once."""

    state: BodyState
    """Poses and velocities."""
    ground_height: torch.Tensor
    """World height of the ground below the pelvis [m], shape [...]."""

    @property
    def height(self) -> torch.Tensor:
        """Height of the pelvis above the ground [m], shape [...]."""
        return self.state.root_position[..., 2] - self.ground_height

    @derived
    def roll_pitch_yaw(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Angles of the pelvis [rad], each of shape [...]."""
        return rotations.roll_pitch_yaw(self.state.root_rotation)

    @derived
    def to_heading(self) -> torch.Tensor:
        """Rotation (x, y, z, w) from the world to it turned by the pelvis's yaw, the heading frame; shape [..., 4]."""
        return rotations.about_z(-self.roll_pitch_yaw[2])

    @derived
    def up(self) -> torch.Tensor:
        """z_global . z_pelvis, shape [...]: 1 when the pelvis is upright, 0 when it lies."""
        return rotations.up_axis(self.state.root_rotation)[..., 2]


@dataclass
class View(BodyView):
    """All robots at the end of a control step, before any of them is reset; every batch has shape [num_envs]."""

    state: RobotState  # pyright: ignore[reportIncompatibleVariableOverride]
    """Robot state."""
    commands: Commands
    """What the robots were told in the step."""
    terrain: Terrain | None
    """The ground; None for the plane at height 0."""
    motors: Motors
    """Gains and limits."""
    torque: torch.Tensor
    """Torque that the network asked for in the step [N m], shape [num_envs, 28]: of AI-CPG the reflex tau_r."""
    torque_unit: torch.Tensor
    """Unit of that torque in rewards and observations [N m], shape [28]."""
    target: torch.Tensor | None = None
    """theta_t of the CPG [rad], shape [num_envs, 28]; None where there is no CPG."""
    target_velocity: torch.Tensor | None = None
    """Its rate over the coming control step [rad/s], shape [num_envs, 28]; None when rewards are given, as what the
    robots are told next is not known then."""

    def ground_below(self, point: torch.Tensor) -> torch.Tensor:
        """World height of the ground below points [m], shape [num_envs, 3] to [num_envs]."""
        return self.ground_height if self.terrain is None else self.terrain.height(point)

    @derived
    def direction(self) -> torch.Tensor:
        """Target direction, a horizontal unit vector in the world, shape [num_envs, 2]."""
        heading = self.commands.heading
        return torch.stack((torch.cos(heading), torch.sin(heading)), dim=1)

    @derived
    def angle_to_target(self) -> torch.Tensor:
        """From where the pelvis faces to the target direction, within half a turn [rad], shape [num_envs]."""
        _, _, yaw = self.roll_pitch_yaw
        return torch.remainder(self.commands.heading - yaw + torch.pi, 2 * torch.pi) - torch.pi

    @derived
    def in_heading_frame(self) -> torch.Tensor:
        """Vectors in the heading frame, shape [num_envs, 18], three numbers each.

        Linear [m/s] and angular velocity [rad/s] of the pelvis, force on the right and the left foot [body weights] and
        moment on both [body weights times 0.1 m]. All at once: on a CPU the number of operations costs more than their
        size.
        """
        state = self.state
        vectors = torch.cat(
            (
                state.root_linear_velocity.unsqueeze(1),
                state.root_angular_velocity.unsqueeze(1),
                state.foot_force / BODY_WEIGHT,
                state.foot_moment / (BODY_WEIGHT * FOOT_LEVER),
            ),
            dim=1,
        )
        to_heading = self.to_heading.unsqueeze(1).expand(-1, vectors.shape[1], 4)
        return rotations.rotate(to_heading, vectors).flatten(1)
