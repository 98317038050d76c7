"""What an engine takes and gives. Joints and links: the order of :mod:`aicpg_newton.robot.humanoid` on both sides."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, ClassVar, Protocol

import torch

from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.errors import UserError
from aicpg_newton.ranges import Range, check_ranges
from aicpg_newton.robot.humanoid import CONTROL_DT


@dataclass(kw_only=True)
class Physics:
    """Settings of the rigid-body simulation."""

    substeps: Annotated[int, Range(2, 1000)] = 4
    """Physics steps per control step of 1/60 s, an even number: 2 are 120 Hz. Tests and play take at least 4."""
    iterations: Annotated[int, Range(1, 1000)] = 10
    """Iterations of the constraint solver (Newton's method)."""
    ls_iterations: Annotated[int, Range(1, 1000)] = 20
    """Line-search iterations in each of them."""
    friction: Annotated[float, Range(0.0, 100.0)] = 1.0
    """Coulomb friction of the ground."""
    max_contacts: Annotated[int, Range(1, 10_000)] = 40
    """Contact points that fit in one environment's buffer."""
    max_constraints: Annotated[int, Range(1, 40_000)] = 200
    """Constraint rows (joint limits, four per contact) that fit in one environment's buffer."""

    capture: bool = True
    """Record the kernels of a control step once and replay them, where they are Warp's (engine newton); off for
    debugging, as then each is launched by itself."""

    @property
    def timestep(self) -> float:
        """Duration of a physics step [s]."""
        return CONTROL_DT / self.substeps

    def validate(self) -> None:
        """Refuse settings that no engine can run.

        Raises:
            UserError: A number is out of its range, or that of substeps is odd.
        """
        check_ranges(self, "physics.")
        if self.substeps % 2:
            raise UserError(f"physics.substeps is {self.substeps}; give an even number of at least 2")


@dataclass
class BodyState:
    """Pose and velocities of humanoids, all that their motion goes on from; world frame."""

    root_position: torch.Tensor
    """Origin of the pelvis frame [m], shape [..., 3]."""
    root_rotation: torch.Tensor
    """Pelvis rotation, unit quaternion (x, y, z, w), shape [..., 4]."""
    root_linear_velocity: torch.Tensor
    """Velocity of the pelvis frame's origin [m/s], shape [..., 3]."""
    root_angular_velocity: torch.Tensor
    """Angular velocity of the pelvis [rad/s], shape [..., 3]."""
    joint_position: torch.Tensor
    """Joint angles [rad], shape [..., 28]."""
    joint_velocity: torch.Tensor
    """Joint velocities [rad/s], shape [..., 28]."""


@dataclass
class RobotState(BodyState):
    """All humanoids after the last control step, a row each: how they move and what was measured on them.

    World frame; feet are ordered right, left.
    """

    joint_torque: torch.Tensor
    """Motor torque of the last physics step [N m], CPG and reflex together, limited; shape [num_envs, 28]."""
    head_position: torch.Tensor
    """Centre of the head [m], shape [num_envs, 3]."""
    foot_force: torch.Tensor
    """Contact force of the ground on each foot, mean over the control step [N], shape [num_envs, 2, 3]."""
    foot_moment: torch.Tensor
    """Its moment about the ankle joint's origin [N m], shape [num_envs, 2, 3]."""

    def finite(self) -> torch.Tensor:
        """Whether every number of an environment is finite, shape [num_envs]."""
        parts = [getattr(self, each.name).flatten(1) for each in fields(self)]
        return torch.isfinite(torch.cat(parts, dim=1)).all(dim=1)


@dataclass
class StepMeasures:
    """Integrals over the physics steps of the last control step, as means over its time; feet are ordered right, left.

    Power of a physics step is the motor torque in it times the mean of the joint velocities before and after it, which
    is the change of energy that the motor causes.
    """

    driving_power: torch.Tensor
    """Mechanical power that each joint's motor puts in [W], shape [num_envs, 28]."""
    braking_power: torch.Tensor
    """Mechanical power that each joint's motor takes out [W], at least 0, shape [num_envs, 28]."""
    contact: torch.Tensor
    """Share of the time that each foot bears more than ``CONTACT_FORCE``, shape [num_envs, 2]."""
    flight: torch.Tensor
    """Share of the time that neither foot does, shape [num_envs]."""


class Engine(Protocol):
    """A batch of humanoids on a plane or on uneven ground, stepped one control step at a time."""

    name: ClassVar[str]
    num_envs: int
    device: torch.device
    terrain: Terrain | None
    """Uneven ground, on the engine's device; None for the endless plane at z = 0."""

    @property
    def state(self) -> RobotState:
        """State after the last :meth:`step` or :meth:`reset`; its tensors are copies that later steps leave alone."""
        ...

    def step(
        self,
        target: torch.Tensor,
        target_velocity: torch.Tensor,
        torque: torch.Tensor,
        *,
        push: torch.Tensor | None = None,
    ) -> None:
        """Advance all environments by one control step of 1/60 s.

        The PD law (Eq. 4) runs in every physics step; the sum of CPG and reflex torque is limited per joint.

        Args:
            target: Target joint angles theta_t [rad], shape [num_envs, 28].
            target_velocity: Their rate [rad/s], shape [num_envs, 28].
            torque: tau_r [N m], shape [num_envs, 28].
            push: External force on the torso's centre of mass, world frame [N], shape [num_envs, 3], for this step.
        """
        ...

    def measures(self) -> StepMeasures:
        """Measures of the last :meth:`step`, copies; a :meth:`reset` after it changes nothing."""
        ...

    def reset(self, mask: torch.Tensor, start: BodyState) -> None:
        """Put the masked environments into new states; the others are not touched.

        Args:
            mask: Environments to reset, bool, shape [num_envs].
            start: The new states, all environments' rows; those outside the mask are ignored.
        """
        ...

    def compile(self) -> None:
        """Make a few kernels of the torch operations around the physics, with a compiler on the machine."""
        ...

    @property
    def overflowed(self) -> torch.Tensor:
        """Environments that ran out of contact or constraint buffers in the last step, bool, shape [num_envs]."""
        ...

    def overflows(self) -> int:
        """Number of environments that ever ran out of contact or constraint buffers."""
        ...

    def snapshot(self) -> dict[str, torch.Tensor]:
        """Copies of all that coming steps depend on, the solver's own memory included; each of shape [num_envs, ...].

        The rows of some environments are a snapshot of an engine that has only those.
        """
        ...

    def restore(self, snapshot: dict[str, torch.Tensor]) -> None:
        """Go on from a :meth:`snapshot` of an engine of the same kind and size: bit for bit, on a CPU.

        Raises:
            ValueError: It has other names or shapes.
        """
        ...


def take_over(snapshot: dict[str, torch.Tensor], arrays: dict[str, torch.Tensor]) -> None:
    """Copy a snapshot's values into an engine's arrays.

    Raises:
        ValueError: Names or shapes differ.
    """
    shapes, own = ({name: each.shape for name, each in group.items()} for group in (snapshot, arrays))
    if shapes != own:
        raise ValueError(f"the snapshot holds {shapes}, the engine {own}")
    for name, array in arrays.items():
        array.copy_(snapshot[name])
