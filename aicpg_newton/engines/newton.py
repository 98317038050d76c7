"""Thousands of humanoids on NVIDIA Newton: MuJoCo-Warp dynamics, torch views of Warp arrays, one graph for a step."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import newton
import numpy as np
import torch
import warp as wp
from mujoco_warp import OverflowType

from aicpg_newton.device import compile_methods
from aicpg_newton.engines import kernels
from aicpg_newton.engines.interface import BodyState, Physics, RobotState, take_over
from aicpg_newton.engines.model import ROOT_COORDINATES, ROOT_DOFS, build, make_solver
from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import FOOT_NAMES, HEAD_CENTRE, LINK_NAMES, MJCF_PATH, Motors

_BUFFERS = ~int(OverflowType.ITERATIONS | OverflowType.LS_ITERATIONS)
"""Bits of the solver's overflows that speak of buffers; the others of iterations that did not converge."""


class NewtonEngine:
    """:class:`~aicpg_newton.engines.interface.Engine` on Newton's SolverMuJoCo (MuJoCo-Warp), CUDA or CPU.

    Args:
        num_envs: Number of humanoids, each in a world of its own.
        device: Torch device, ``cuda:0`` or ``cpu``.
        motors: Gains, limits, damping and armature per joint.
        physics: Simulation settings.
        terrain: Uneven ground; None for a plane.
        mjcf: Geometry; joints and links are found by name.
    """

    name: ClassVar[str] = "newton"

    def __init__(
        self,
        num_envs: int,
        device: torch.device | str,
        motors: Motors,
        physics: Physics,
        terrain: Terrain | None = None,
        mjcf: Path = MJCF_PATH,
    ) -> None:
        self.num_envs = num_envs
        self.device = torch.device(device)
        self.physics = physics
        self.terrain = None if terrain is None else terrain.to(self.device)
        builder, layout = build(num_envs, motors, physics, mjcf, terrain)
        self._wp_device = wp.device_from_torch(self.device)
        # Any: Newton annotates its arrays as optional.
        self.model: Any = builder.finalize(device=self._wp_device)
        self.solver = make_solver(self.model, physics, use_mujoco_contacts=terrain is None)
        # An even number of substeps ends in the state it began in, so a captured graph needs no copy.
        self._states: tuple[Any, Any] = (self.model.state(), self.model.state())
        self._control: Any = self.model.control()
        self._collisions = None if terrain is None else self._make_collisions(terrain.ground.cell)
        self._contacts: Any = (
            newton.Contacts(self.solver.get_max_contact_count(), 0, device=self._wp_device)
            if self._collisions is None
            else self._collisions.contacts()
        )
        kinds = self.solver.ObservableKind
        self._observables: Any = self.solver.observables(
            {kinds.CONTACT_F, kinds.QFRC_ACTUATOR, kinds.OVERFLOW}, contacts=self._contacts
        )
        self._map_layout(layout.joints, layout.links, layout.foot_shapes)
        self._view_arrays()
        newton.eval_fk(self.model, self._states[0].joint_q, self._states[0].joint_qd, self._states[0])
        self._graph: wp.Graph | None = None
        if physics.capture:
            self._substeps()  # compiles every kernel before the capture
            with wp.ScopedCapture(device=self._wp_device) as capture:
                self._substeps()
            self._graph = capture.graph
            self.solver.reset(self._states[0])
            self._torque.zero_()
            self._foot_wrench.zero_()
            for array in (self._overflow_array, self._most):
                array.zero_()
            newton.eval_fk(self.model, self._states[0].joint_q, self._states[0].joint_qd, self._states[0])
        self.state = self._read()

    def compile(self) -> None:
        """See :meth:`Engine.compile`."""
        compile_methods(self, ("_tell", "_measure", "_place", "_read"))

    def _make_collisions(self, cell: float) -> newton.CollisionPipeline:
        """Newton's own collision detection, for uneven ground of cells of this size [m].

        MuJoCo-Warp's finds one contact point per triangle and shape, and walls where two triangles meet.
        """
        upper, lower = self.model.shape_collision_aabb_upper.numpy(), self.model.shape_collision_aabb_lower.numpy()
        # As far as a shape reaches, however it turns; the last shape is the ground.
        cells = np.ceil(np.linalg.norm(upper - lower, axis=1)[:-1] / cell) + 1
        return newton.CollisionPipeline(
            self.model,
            broad_phase="explicit",
            rigid_contact_max=self.solver.get_max_contact_count(),
            max_triangle_pairs=int(2 * (cells**2).sum()),
            soft_contact_max=0,
            verify_buffers=False,
        )

    def _map_layout(self, joints: tuple[int, ...], links: tuple[int, ...], foot_shapes: tuple[int, ...]) -> None:
        hinges = torch.tensor(joints, device=self.device)
        self._own_order = hinges.argsort()  # from the package's order to the model's, whose joints follow the root
        self._coordinates = ROOT_COORDINATES + hinges
        self._dofs = ROOT_DOFS + hinges
        self._pelvis, self._torso, self._head = (links[LINK_NAMES.index(name)] for name in ("pelvis", "torso", "head"))
        bodies, shapes = self.model.body_count // self.num_envs, (self.model.shape_count - 1) // self.num_envs
        worlds = torch.arange(self.num_envs).unsqueeze(1)
        feet = torch.tensor([links[LINK_NAMES.index(name)] for name in FOOT_NAMES])
        foot_of_shape = torch.full((self.model.shape_count,), -1, dtype=torch.int32)
        shape_of_foot = (worlds * shapes + torch.tensor(foot_shapes)).flatten()
        foot_of_shape[shape_of_foot] = torch.arange(shape_of_foot.numel(), dtype=torch.int32)
        self._foot_of_shape = wp.array(foot_of_shape.numpy(), dtype=wp.int32, device=self._wp_device)
        foot_body = (worlds * bodies + feet).flatten().to(torch.int32)
        self._foot_body = wp.array(foot_body.numpy(), dtype=wp.int32, device=self._wp_device)
        self._foot_wrench_array: Any = wp.zeros(self.num_envs * 2, dtype=wp.spatial_vectorf, device=self._wp_device)
        self._overflow_array = wp.zeros(self.num_envs, dtype=wp.int32, device=self._wp_device)
        self._most = wp.zeros(2, dtype=wp.int32, device=self._wp_device)
        self._reset_worlds = wp.zeros(self.num_envs + 1, dtype=wp.bool, device=self._wp_device)
        self._reset_robots = wp.zeros(self.num_envs, dtype=wp.bool, device=self._wp_device)

    def _view_arrays(self) -> None:
        """Torch views of the Warp arrays that are read and written around the substeps; nothing is copied."""
        n = self.num_envs
        state = self._states[0]
        self._joint_q = wp.to_torch(state.joint_q).view(n, -1)
        self._joint_qd = wp.to_torch(state.joint_qd).view(n, -1)
        self._body_q = wp.to_torch(state.body_q).view(n, -1, 7)
        self._body_f = [wp.to_torch(each.body_f).view(n, -1, 6) for each in self._states]
        self._target_q = wp.to_torch(self._control.joint_target_q).view(n, -1)
        self._target_qd = wp.to_torch(self._control.joint_target_qd).view(n, -1)
        self._torque = wp.to_torch(self._observables.qfrc_actuator).view(n, -1)
        self._warm_start = wp.to_torch(self.solver.mjw_data.qacc_warmstart)
        self._foot_wrench = wp.to_torch(self._foot_wrench_array).view(n, 2, 6)
        self._overflow = wp.to_torch(self._overflow_array)
        self._ever_overflowed = torch.zeros(n, dtype=torch.bool, device=self.device)
        self._world_mask = wp.to_torch(self._reset_worlds)
        self._robot_mask = wp.to_torch(self._reset_robots)
        com = wp.to_torch(self.model.body_com).view(n, -1, 3)
        self._pelvis_com = com[:, self._pelvis].clone()
        self._head_centre = torch.tensor(HEAD_CENTRE, device=self.device).expand(n, 3)
        self._position_gain = wp.to_torch(self.model.joint_target_ke).view(n, -1)[:, self._dofs].clone()

    def _substeps(self) -> None:
        """All physics steps of a control step, in Warp only, so that a graph can hold them, on a GPU and on a CPU."""
        self._foot_wrench_array.zero_()
        self._overflow_array.zero_()
        state_in, state_out = self._states
        for _ in range(self.physics.substeps):
            if self._collisions is not None:
                self._collide(self._collisions, state_in)
            self.solver.step(
                state_in,
                state_out,
                self._control,
                self._contacts,
                self.physics.timestep,
                observables=self._observables,
            )
            wp.launch(
                kernels.add_foot_wrenches,
                dim=self._contacts.rigid_contact_max,
                inputs=[
                    self._contacts.rigid_contact_count,
                    self._contacts.rigid_contact_shape0,
                    self._contacts.rigid_contact_shape1,
                    self._contacts.rigid_contact_point0,
                    self._contacts.rigid_contact_point1,
                    self._observables.contact_f,
                    self._foot_of_shape,
                    self._foot_body,
                    state_out.body_q,
                    1.0 / self.physics.substeps,
                ],
                outputs=[self._foot_wrench_array],
                device=self._wp_device,
            )
            wp.launch(
                kernels.note_buffers,
                dim=self.num_envs,
                inputs=[
                    self._observables.overflow,
                    _BUFFERS,
                    self.solver.mjw_data.nefc,
                    self._contacts.rigid_contact_count,
                ],
                outputs=[self._overflow_array, self._most],
                device=self._wp_device,
            )
            state_in, state_out = state_out, state_in

    def _collide(self, collisions: newton.CollisionPipeline, state: Any) -> None:
        """Find the contacts with uneven ground; part of :meth:`_substeps`."""
        collisions.collide(state, self._contacts)
        narrow: Any = collisions.narrow_phase
        wp.launch(
            kernels.note_lost_contacts,
            dim=self.num_envs,
            inputs=[
                narrow.triangle_pairs_count,
                narrow.triangle_pairs.shape[0],
                narrow.global_contact_reducer.buffer_overflows,
                narrow.global_contact_reducer.ht_insert_failures,
            ],
            outputs=[self._overflow_array],
            device=self._wp_device,
        )

    def step(
        self,
        target: torch.Tensor,
        target_velocity: torch.Tensor,
        torque: torch.Tensor,
        *,
        push: torch.Tensor | None = None,
    ) -> None:
        """See :meth:`Engine.step`. A torque on top of the PD law is a shift of its position target by tau_r / Kp."""
        self._tell(target, target_velocity, torque, push)
        if self._graph is not None:
            wp.capture_launch(self._graph)
        else:
            self._substeps()
        self.state = self._measure()

    def _tell(
        self, target: torch.Tensor, target_velocity: torch.Tensor, torque: torch.Tensor, push: torch.Tensor | None
    ) -> None:
        """Put what a step was given where the physics reads it."""
        shifted = target + torque / self._position_gain
        self._target_q[:, ROOT_COORDINATES:] = shifted[:, self._own_order]
        self._target_qd[:, ROOT_DOFS:] = target_velocity[:, self._own_order]
        for body_f in self._body_f:
            body_f.zero_()
            if push is not None:
                body_f[:, self._torso, :3] = push

    def _measure(self) -> RobotState:
        """The state after a step; whether a buffer was full is kept."""
        self._ever_overflowed = self._ever_overflowed | self.overflowed
        return self._read()

    def reset(self, mask: torch.Tensor, start: BodyState) -> None:
        """See :meth:`Engine.reset`."""
        self._place(mask, start)
        state = self._states[0]
        self.solver.reset(state, self._reset_worlds, flags=0)
        newton.eval_fk(self.model, state.joint_q, state.joint_qd, state, mask=self._reset_robots)
        self.state = self._read()

    def _place(self, mask: torch.Tensor, start: BodyState) -> None:
        """Put masked robots where they start; Newton's free joint carries the velocity of the centre of mass."""
        com = rotations.rotate(start.root_rotation, self._pelvis_com)
        com_velocity = start.root_linear_velocity + torch.linalg.cross(start.root_angular_velocity, com)
        hinges, rates = (each[:, self._own_order] for each in (start.joint_position, start.joint_velocity))
        joint_q = torch.cat((start.root_position, start.root_rotation, hinges), dim=1)
        joint_qd = torch.cat((com_velocity, start.root_angular_velocity, rates), dim=1)
        rows = mask.unsqueeze(1)
        self._joint_q.copy_(torch.where(rows, joint_q, self._joint_q))
        self._joint_qd.copy_(torch.where(rows, joint_qd, self._joint_qd))
        self._torque.masked_fill_(rows, 0.0)
        self._foot_wrench.masked_fill_(rows.unsqueeze(2), 0.0)
        self._world_mask[:-1] = mask
        self._robot_mask.copy_(mask)

    def _read(self) -> RobotState:
        """The state as parts of one new tensor, which is one copy where it would be ten."""
        rotation = self._joint_q[:, 3:ROOT_COORDINATES]
        angular_velocity = self._joint_qd[:, 3:ROOT_DOFS]
        com = rotations.rotate(rotation, self._pelvis_com)
        head = self._body_q[:, self._head]
        wrench = self._foot_wrench
        parts = {
            "root_position": self._joint_q[:, :3],
            "root_rotation": rotation,
            "root_linear_velocity": self._joint_qd[:, :3] - torch.linalg.cross(angular_velocity, com),
            "root_angular_velocity": angular_velocity,
            "joint_position": self._joint_q[:, self._coordinates],
            "joint_velocity": self._joint_qd[:, self._dofs],
            "joint_torque": self._torque[:, self._dofs],
            "head_position": head[:, :3] + rotations.rotate(head[:, 3:], self._head_centre),
            "foot_force": wrench[..., :3].flatten(1),
            "foot_moment": wrench[..., 3:].flatten(1),
        }
        copies = torch.cat(list(parts.values()), dim=1).split([part.shape[1] for part in parts.values()], dim=1)
        state = dict(zip(parts, copies, strict=True))
        for name in ("foot_force", "foot_moment"):
            state[name] = state[name].unflatten(1, (2, 3))
        return RobotState(**state)

    def high_water(self) -> dict[str, float]:
        """Fullest buffers so far: constraints of any one environment, and contacts per environment over all of them."""
        constraints, contacts = self._most.numpy().tolist()
        return {"constraints": constraints, "contacts": contacts / self.num_envs}

    @property
    def overflowed(self) -> torch.Tensor:
        """See :attr:`Engine.overflowed`; all of them where a buffer that they share is full."""
        return self._overflow != 0

    def overflows(self) -> int:
        """See :meth:`Engine.overflows`."""
        return int(self._ever_overflowed.sum())

    def _memory(self) -> dict[str, torch.Tensor]:
        """All that is kept from step to step: motion, what the solver warm-starts from, and what was measured."""
        return {
            "joint_q": self._joint_q,
            "joint_qd": self._joint_qd,
            "body_q": self._body_q,
            "warm_start": self._warm_start,
            "motor_torque": self._torque,
            "foot_wrench": self._foot_wrench,
        }

    def snapshot(self) -> dict[str, torch.Tensor]:
        """See :meth:`Engine.snapshot`."""
        return {name: each.clone() for name, each in self._memory().items()}

    def restore(self, snapshot: dict[str, torch.Tensor]) -> None:
        """See :meth:`Engine.restore`."""
        take_over(snapshot, self._memory())
        self.state = self._read()
