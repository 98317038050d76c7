"""Thousands of humanoids on NVIDIA Newton: MuJoCo-Warp dynamics, torch views of Warp arrays, one graph for a step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, ClassVar, cast

import newton
import numpy as np
import torch
import warp as wp
from mujoco_warp import OverflowType

from aicpg_newton.device import compile_methods
from aicpg_newton.engines import kernels
from aicpg_newton.engines.interface import BodyState, Physics, RobotState, StepMeasures, take_over
from aicpg_newton.engines.model import build, make_solver
from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.robot.humanoid import FOOT_NAMES, HEAD_CENTRE, LINK_NAMES, MJCF_PATH, NUM_JOINTS, Motors

_BUFFERS = ~int(OverflowType.ITERATIONS | OverflowType.LS_ITERATIONS)
"""Bits of the solver's overflows that speak of buffers; the others of iterations that did not converge."""

_START = tuple(each.name for each in fields(BodyState))
"""What a robot starts with."""


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
        self._make_arrays()
        newton.eval_fk(self.model, self._states[0].joint_q, self._states[0].joint_qd, self._states[0])
        self._step_graph: wp.Graph | None = None
        self._reset_graph: wp.Graph | None = None
        if physics.capture:
            self._step_graph, self._reset_graph = self._record(self._advance), self._record(self._start_anew)
            self.solver.reset(self._states[0])
            for array in (
                *(self._observables.qfrc_actuator, self._foot_wrench, self._measures),
                *(self._overflow, self._ever, self._most),
            ):
                array.zero_()
        newton.eval_fk(self.model, self._states[0].joint_q, self._states[0].joint_qd, self._states[0])
        self._gather()
        self.state = self._told()

    def _record(self, kernels_of: Callable[[], None]) -> wp.Graph:
        """A graph of the kernels that a function launches, Warp's only, on a GPU and on a CPU."""
        kernels_of()  # compiles every kernel before the capture
        with wp.ScopedCapture(device=self._wp_device) as capture:
            kernels_of()
        return cast(wp.Graph, capture.graph)

    def compile(self) -> None:
        """See :meth:`Engine.compile`."""
        compile_methods(self, ("_tell", "_ask_for_start"), self.device)

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
        self._pelvis, self._torso, self._head = (links[LINK_NAMES.index(name)] for name in ("pelvis", "torso", "head"))
        bodies, shapes = self.model.body_count // self.num_envs, (self.model.shape_count - 1) // self.num_envs
        worlds = np.arange(self.num_envs)[:, None]
        foot_body = worlds * bodies + [links[LINK_NAMES.index(name)] for name in FOOT_NAMES]
        foot_of_shape = np.full(self.model.shape_count, -1)
        foot_of_shape[worlds * shapes + np.array(foot_shapes)] = np.arange(2 * self.num_envs).reshape(-1, 2)
        self._hinges, self._foot_of_shape, self._foot_body = (
            wp.array(np.ravel(each), dtype=wp.int32, device=self._wp_device)
            for each in (joints, foot_of_shape, foot_body)
        )

    def _make_arrays(self) -> None:
        """Warp arrays of all that is told to the physics and read from it, a row for each robot, and torch views."""
        n, state = self.num_envs, self._states[0]

        def zeros(shape: int | tuple[int, int], kind: Any) -> Any:
            return wp.zeros(shape, dtype=kind, device=self._wp_device)

        def rows(array: Any) -> Any:
            return array.reshape((n, -1))

        self._command, self._start, self._state = (
            zeros((n, sum(sizes)), wp.float32)
            for sizes in (kernels.COMMAND_SIZES, kernels.START_SIZES, kernels.STATE_SIZES)
        )
        self._foot_wrench, self._step_wrench = zeros((n, 2), wp.spatial_vectorf), zeros((n, 2), wp.spatial_vectorf)
        self._measures = zeros((n, sum(kernels.MEASURE_SIZES)), wp.float32)
        self._overflow, self._ever, self._most = zeros(n, wp.int32), zeros(n, wp.int32), zeros(2, wp.int32)
        self._world_mask = zeros(n + 1, wp.bool)  # the last world is that of what belongs to none
        self._robot_mask = self._world_mask[:n]
        self._position, self._velocity, self._body_pose = rows(state.joint_q), rows(state.joint_qd), rows(state.body_q)
        self._motor_torque = rows(self._observables.qfrc_actuator)
        self._centre_of_mass = rows(self.model.body_com)
        self._command_view, self._start_view, self._state_view, self._mask_view, self._overflow_view = map(
            wp.to_torch, (self._command, self._start, self._state, self._robot_mask, self._overflow)
        )
        self._no_push = torch.zeros(n, 3, device=self.device)

    def _advance(self) -> None:
        """A control step, in Warp only, so that a graph can hold it: command, physics steps, state."""
        wp.launch(
            kernels.write_command,
            dim=(self.num_envs, NUM_JOINTS),
            inputs=[
                self._command,
                self._hinges,
                self._torso,
                self.model.joint_target_ke.reshape((self.num_envs, -1)),
            ],
            outputs=[
                each.reshape((self.num_envs, -1))
                for each in (
                    self._control.joint_target_q,
                    self._control.joint_target_qd,
                    *(state.body_f for state in self._states),
                )
            ]
            + [self._foot_wrench, self._measures, self._overflow],
            device=self._wp_device,
        )
        self._substeps()
        self._gather()

    def _start_anew(self) -> None:
        """Start masked robots anew, in Warp only."""
        wp.launch(
            kernels.place,
            dim=(self.num_envs, NUM_JOINTS),
            inputs=[self._robot_mask, self._start, self._hinges, self._pelvis, self._centre_of_mass],
            outputs=[self._position, self._velocity, self._motor_torque, self._foot_wrench],
            device=self._wp_device,
        )
        state = self._states[0]
        self.solver.reset(state, self._world_mask, flags=0)
        newton.eval_fk(self.model, state.joint_q, state.joint_qd, state, mask=self._robot_mask)
        self._gather()

    def _gather(self) -> None:
        """Put what is told of the robots into one array."""
        wp.launch(
            kernels.read_state,
            dim=(self.num_envs, NUM_JOINTS),
            inputs=[
                self._hinges,
                self._pelvis,
                self._head,
                wp.vec3(*HEAD_CENTRE),
                self._centre_of_mass,
                self._position,
                self._velocity,
                self._body_pose,
                self._motor_torque,
                self._foot_wrench,
            ],
            outputs=[self._state],
            device=self._wp_device,
        )

    def _substeps(self) -> None:
        """All physics steps of a control step."""
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
                ],
                outputs=[self._step_wrench.flatten()],
                device=self._wp_device,
            )
            wp.launch(
                kernels.measure_step,
                dim=(self.num_envs, NUM_JOINTS),
                inputs=[
                    *(state.joint_qd.reshape((self.num_envs, -1)) for state in (state_in, state_out)),
                    self._hinges,
                    self._motor_torque,
                    1.0 / self.physics.substeps,
                    self._step_wrench,
                    self._observables.overflow,
                    _BUFFERS,
                    self.solver.mjw_data.nefc,
                    self._contacts.rigid_contact_count,
                ],
                outputs=[self._foot_wrench, self._measures, self._overflow, self._ever, self._most],
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
            outputs=[self._overflow],
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
        """See :meth:`Engine.step`."""
        self._tell(target, target_velocity, torque, self._no_push if push is None else push)
        self._run(self._step_graph, self._advance)
        self.state = self._told()

    def measures(self) -> StepMeasures:
        """See :meth:`Engine.measures`."""
        driving, braking, contact, flight = wp.to_torch(self._measures).clone().split(kernels.MEASURE_SIZES, dim=1)
        return StepMeasures(driving, braking, contact, flight.squeeze(1))

    def _run(self, graph: wp.Graph | None, kernels_of: Callable[[], None]) -> None:
        """Replay a graph, or launch its kernels one by one where nothing was recorded."""
        if graph is not None:
            wp.capture_launch(graph)
        else:
            kernels_of()

    def _tell(
        self, target: torch.Tensor, target_velocity: torch.Tensor, torque: torch.Tensor, push: torch.Tensor
    ) -> None:
        """Put what a step was given where its kernels read it."""
        self._command_view.copy_(torch.cat((target, target_velocity, torque, push), dim=1))

    def reset(self, mask: torch.Tensor, start: BodyState) -> None:
        """See :meth:`Engine.reset`."""
        self._ask_for_start(mask, start)
        self._run(self._reset_graph, self._start_anew)
        self.state = self._told()

    def _ask_for_start(self, mask: torch.Tensor, start: BodyState) -> None:
        """Put who starts anew, and how, where the kernels read it."""
        self._mask_view.copy_(mask)
        self._start_view.copy_(torch.cat([getattr(start, name) for name in _START], dim=1))

    def _told(self) -> RobotState:
        """The state as parts of one new tensor, which is one copy where it would be ten."""
        parts = self._state_view.clone().split(kernels.STATE_SIZES, dim=1)
        state = dict(zip((each.name for each in fields(RobotState)), parts, strict=True))
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
        return self._overflow_view != 0

    def overflows(self) -> int:
        """See :meth:`Engine.overflows`."""
        return int((self._ever.numpy() != 0).sum())

    def _memory(self) -> dict[str, torch.Tensor]:
        """All that is kept from step to step: motion, what the solver warm-starts from, and what was measured."""
        arrays = {
            "joint_q": self._position,
            "joint_qd": self._velocity,
            "body_q": self._body_pose,
            "warm_start": self.solver.mjw_data.qacc_warmstart,
            "motor_torque": self._motor_torque,
            "foot_wrench": self._foot_wrench,
        }
        return {name: wp.to_torch(each) for name, each in arrays.items()}

    def snapshot(self) -> dict[str, torch.Tensor]:
        """See :meth:`Engine.snapshot`."""
        return {name: each.clone() for name, each in self._memory().items()}

    def restore(self, snapshot: dict[str, torch.Tensor]) -> None:
        """See :meth:`Engine.restore`."""
        take_over(snapshot, self._memory())
        self._gather()
        self.state = self._told()
