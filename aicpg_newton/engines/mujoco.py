"""Humanoids on all cores of a CPU: MuJoCo's C engine, stepping in threads the model that Newton exports."""

# The type checker cannot see into MuJoCo's compiled module.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
import torch
from mujoco.rollout import Rollout

from aicpg_newton.device import cpu_cores
from aicpg_newton.engines.interface import BodyState, Physics, RobotState, StepMeasures, take_over
from aicpg_newton.engines.model import ROOT_DOFS, build, make_solver
from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.errors import UserError
from aicpg_newton.files import temporary_folder
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import (
    FOOT_NAMES,
    HEAD_CENTRE,
    LINK_NAMES,
    MJCF_PATH,
    NUM_JOINTS,
    SPINE_JOINTS,
    Motors,
    joint_index,
)
from aicpg_newton.robot.locomotion import feet_on_ground

_TORSO, _HEAD = LINK_NAMES.index("torso"), LINK_NAMES.index("head")


_XYZW = [4, 5, 6, 3]
"""Where MuJoCo's joint coordinates hold the root's quaternion, which it writes (w, x, y, z)."""

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
"""What a row of the batch holds: time, joint coordinates, joint velocities."""

_INPUT = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
"""What every physics step is given: the actuators' inputs, then force and torque on each body's centre of mass."""

_FOOT_READINGS = 12
"""Sensor values of a foot: contact force, torque and their point, then the foot frame's origin."""

_NET_FORCE = 3
"""MuJoCo's ``reduce="netforce"``: all contacts of a body as one force and torque in the world frame."""

_LARGEST = 1e10
"""MuJoCo's own bound (mjMAXVAL) on a sound coordinate or velocity."""

_DEPTH = 100.0
"""How far uneven ground is solid below its lowest point [m]; see :func:`_replace_plane`."""

_STUD = 0.003
"""Half the side of the studs at the corners of a sole [m]; see :func:`_add_studs`."""

_Array = np.ndarray[Any, np.dtype[np.float64]]


class MujocoEngine:
    """:class:`~aicpg_newton.engines.interface.Engine` on MuJoCo's C engine, a thread for every core; CPU only.

    The state is kept in double precision; the tensors that go in and out are single.

    Args:
        num_envs: Number of humanoids.
        device: ``cpu``.
        motors: Gains, limits, damping and armature per joint.
        physics: Simulation settings; the buffer sizes have no meaning here, see :meth:`overflows`.
        terrain: Uneven ground; None for a plane.
        mjcf: Geometry; joints and links are found by name.

    Raises:
        UserError: The device is not the CPU.
    """

    name: ClassVar[str] = "mujoco"

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
        if self.device.type != "cpu":
            raise UserError(f"engine 'mujoco' cannot run on device {str(self.device)!r}; use cpu or engine 'newton'")
        # On its own MuJoCo prints a line for every robot that diverges, and another into a file where it runs; such
        # robots show up as not finite, and whoever steps them counts them.
        mujoco.set_mju_user_warning(lambda text: None)
        self.physics = physics
        self.terrain = None if terrain is None else terrain.to(self.device)
        self._load(motors, mjcf)
        threads = min(cpu_cores(), num_envs)
        self._rollout = Rollout(nthread=threads)
        self._data = [mujoco.MjData(self.model) for _ in range(threads)]
        self._models = [self.model] * num_envs
        rest = np.concatenate(([0.0], self.model.qpos0, np.zeros(self.model.nv)))
        assert mujoco.mj_stateSize(self.model, _STATE) == rest.size
        self._rest = rest
        self._rows: _Array = np.tile(rest, (num_envs, 1))
        self._batch = torch.from_numpy(self._rows)  # the same memory
        self._inputs: _Array = np.zeros((num_envs, physics.substeps, mujoco.mj_stateSize(self.model, _INPUT)))
        self._trajectory: _Array = np.zeros((num_envs, physics.substeps, rest.size))
        self._readings: _Array = np.zeros((num_envs, physics.substeps, self.model.nsensordata))
        self._before = np.zeros((num_envs, self.model.nv))  # generalised velocities at the start of the step
        self._torque = torch.zeros(num_envs, NUM_JOINTS)
        self._foot_wrench = torch.zeros(num_envs, 2, 6)
        self.overflowed = torch.zeros(num_envs, dtype=torch.bool)
        """See :attr:`Engine.overflowed`: never, see :meth:`overflows`."""
        self.state = self._read()

    def _load(self, motors: Motors, mjcf: Path) -> None:
        """Take over Newton's model, add sensors to it, and find the package's joints and links in it."""
        builder, layout = build(1, motors, self.physics, mjcf)
        with temporary_folder() as folder, contextlib.redirect_stdout(io.StringIO()):
            path = folder / "humanoid.xml"
            solver = make_solver(
                builder.finalize(device="cpu"), self.physics, use_mujoco_cpu=True, save_to_mjcf=str(path)
            )
            spec = mujoco.MjSpec.from_file(str(path))
        exported = solver.mj_model
        assert solver.mjc_body_to_newton is not None and solver.mjc_jnt_to_newton_dof is not None
        body_of = {int(body): i for i, body in enumerate(solver.mjc_body_to_newton.numpy()[0])}
        joint_of = {int(dof): i for i, dof in enumerate(solver.mjc_jnt_to_newton_dof.numpy()[0])}
        bodies = [body_of[link] for link in layout.links]
        joints = [joint_of[ROOT_DOFS + hinge] for hinge in layout.joints]
        add_sensors(
            spec,
            [exported.body(bodies[LINK_NAMES.index(name)]).name for name in FOOT_NAMES],
            [exported.joint(joint).name for joint in joints],
        )
        if self.terrain is not None:
            _replace_plane(spec, self.terrain)
        spec.option.timestep = self.physics.timestep
        # Left on, it would put a diverged environment back to the initial pose without a word.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET.value
        # One robot is one island: looking for others took a fifth of the time.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND.value
        self.spec = spec
        """What the model was made from, with Newton's names."""
        model = self.model = spec.compile()
        self._qpos_columns = torch.from_numpy(model.jnt_qposadr[joints]).long()
        self._qvel_columns = torch.from_numpy(model.jnt_dofadr[joints]).long()
        self._spine_columns = self._qpos_columns[[joint_index(name) for name in SPINE_JOINTS]]
        position_actuator = {}
        velocity_actuator = {}
        for actuator in range(model.nu):
            is_position = model.actuator_biasprm[actuator, 1] != 0.0
            (position_actuator if is_position else velocity_actuator)[int(model.actuator_trnid[actuator, 0])] = actuator
        self._position_inputs = np.array([position_actuator[joint] for joint in joints])
        self._velocity_inputs = np.array([velocity_actuator[joint] for joint in joints])
        self._position_gain = model.actuator_gainprm[self._position_inputs, 0].copy()
        torso_wrench = model.nu + 6 * bodies[_TORSO]
        self._push_inputs = slice(torso_wrench, torso_wrench + 3)
        self._torso_offset, self._head_offset = (
            torch.tensor(model.body_pos[bodies[link]], dtype=torch.float32) for link in (_TORSO, _HEAD)
        )
        self._head_centre = torch.tensor(HEAD_CENTRE)

    def step(
        self,
        target: torch.Tensor,
        target_velocity: torch.Tensor,
        torque: torch.Tensor,
        *,
        push: torch.Tensor | None = None,
    ) -> None:
        """See :meth:`Engine.step`. A torque on top of the PD law is a shift of its position target by tau_r / Kp."""
        shifted = target.detach().double().numpy() + torque.detach().double().numpy() / self._position_gain
        inputs = np.zeros((self.num_envs, self._inputs.shape[2]))
        inputs[:, self._position_inputs] = shifted
        inputs[:, self._velocity_inputs] = target_velocity.detach().numpy()
        if push is not None:
            inputs[:, self._push_inputs] = push.detach().numpy()
        # MuJoCo replaces inputs that are not finite by zeros; such environments are to show up as not finite instead.
        sound = np.isfinite(inputs).all(axis=1) & (np.abs(self._rows) < _LARGEST).all(axis=1)
        self._rows[~sound] = self._rest
        inputs[~sound] = 0.0
        self._inputs[:] = inputs[:, None]
        self._rows[:, 0] = 0.0
        self._before[:] = self._rows[:, 1 + self.model.nq :]
        self._rollout.rollout(
            self._models,
            self._data,
            self._rows,
            self._inputs,
            control_spec=_INPUT,
            skip_checks=True,
            nstep=self.physics.substeps,
            state=self._trajectory,
            sensordata=self._readings,
        )
        self._rows[:] = self._trajectory[:, -1]
        # A rollout stops at MuJoCo's first warning, of numbers too large or of memory; its clock tells.
        sound &= self._rows[:, 0] > (self.physics.substeps - 0.5) * self.physics.timestep
        self._rows[~sound] = np.nan
        self._readings[~sound] = np.nan
        self._read_sensors()
        self.state = self._read()

    def measures(self) -> StepMeasures:
        """See :meth:`Engine.measures`. Sensors are read at the start of each physics step, whose torque they hold."""
        readings = torch.from_numpy(self._readings)
        after = torch.from_numpy(self._trajectory[:, :, 1 + self.model.nq :])
        before = torch.cat((torch.from_numpy(self._before).unsqueeze(1), after[:, :-1]), dim=1)
        velocity = 0.5 * (before + after)[..., self._qvel_columns]
        power = readings[..., 2 * _FOOT_READINGS :] * velocity
        force, *_ = self._foot_sensors()
        contact = feet_on_ground(-force)
        return StepMeasures(
            driving_power=power.clamp_min(0.0).mean(dim=1).float(),
            braking_power=(-power).clamp_min(0.0).mean(dim=1).float(),
            contact=contact.float().mean(dim=1),
            flight=(~contact.any(dim=2)).float().mean(dim=1),
        )

    def reset(self, mask: torch.Tensor, start: BodyState) -> None:
        """See :meth:`Engine.reset`."""
        qpos, qvel = self.coordinates(start)
        clock = qpos.new_zeros(len(qpos), 1)  # that of an environment that was not finite is not, either
        self._batch[mask] = torch.cat((clock, qpos, qvel), dim=1)[mask]
        self._torque[mask] = 0.0
        self._foot_wrench[mask] = 0.0
        self.state = self._read()

    def coordinates(self, start: BodyState) -> tuple[torch.Tensor, torch.Tensor]:
        """States as MuJoCo has them: the root's quaternion (w, x, y, z), its angular velocity in the pelvis frame.

        Args:
            start: States of any number of robots.

        Returns:
            Joint coordinates qpos, shape [rows, 35], and velocities qvel, shape [rows, 34], in double precision.
        """
        position, rotation, linear_velocity, angular_velocity, angles, rates = (
            getattr(start, each.name).double() for each in fields(BodyState)
        )
        qpos, qvel = position.new_empty(len(position), self.model.nq), position.new_empty(len(position), self.model.nv)
        qpos[:, :3], qpos[:, _XYZW], qpos[:, self._qpos_columns] = position, rotation, angles
        qvel[:, :3], qvel[:, self._qvel_columns] = linear_velocity, rates
        qvel[:, 3:ROOT_DOFS] = rotations.rotate(rotations.conjugate(rotation), angular_velocity)
        return qpos, qvel

    def compile(self) -> None:
        """See :meth:`Engine.compile`: beside the physics there is too little to do here."""

    def _read_sensors(self) -> None:
        """Motor torque of the last physics step and each foot's wrench about its frame's origin, mean over all."""
        force, torque, point, origin = self._foot_sensors()
        wrench = torch.cat((force, torque + torch.linalg.cross(point - origin, force)), dim=-1)
        self._foot_wrench = -wrench.mean(dim=1).float()  # MuJoCo gives the foot's on the ground
        self._torque = torch.from_numpy(self._readings[:, -1, 2 * _FOOT_READINGS :]).float()

    def _foot_sensors(self) -> tuple[torch.Tensor, ...]:
        """Force and torque of each foot on the ground, where they act, and the foot frame's origin.

        Each of shape [num_envs, substeps, 2, 3], world frame.
        """
        feet = torch.from_numpy(self._readings[..., : 2 * _FOOT_READINGS])
        return feet.reshape(self.num_envs, self.physics.substeps, 2, 4, 3).unbind(dim=3)

    def _read(self) -> RobotState:
        """The state as new tensors: the way from double to single precision copies."""
        _, qpos, qvel = self._batch.float().split((1, self.model.nq, self.model.nv), dim=1)
        position, rotation = qpos[:, :3].clone(), qpos[:, _XYZW]
        # Centre of the head; a sensor's reading would be one physics step old.
        spine = qpos.index_select(1, self._spine_columns).reshape(-1, 2, 3)
        abdomen, neck = rotations.from_euler_xyz(spine).unbind(dim=1)
        from_torso = self._head_offset + rotations.rotate(neck, self._head_centre.expand_as(position))
        from_pelvis = self._torso_offset + rotations.rotate(abdomen, from_torso)
        in_pelvis = torch.stack((qvel[:, 3:ROOT_DOFS], from_pelvis), dim=1)
        angular_velocity, to_head = rotations.rotate(rotation.unsqueeze(1).expand(-1, 2, 4), in_pelvis).unbind(dim=1)
        return RobotState(
            root_position=position,
            root_rotation=rotation,
            root_linear_velocity=qvel[:, :3].clone(),
            root_angular_velocity=angular_velocity.clone(),
            joint_position=qpos.index_select(1, self._qpos_columns),
            joint_velocity=qvel.index_select(1, self._qvel_columns),
            joint_torque=self._torque.clone(),
            head_position=position + to_head,
            foot_force=self._foot_wrench[..., :3].clone(),
            foot_moment=self._foot_wrench[..., 3:].clone(),
        )

    def bare_loop(self) -> Callable[[], None]:
        """The library's own loop from the present states with fixed inputs, for the benchmark to compare with."""
        rows, inputs = self._rows.copy(), self._inputs.copy()

        def step() -> None:
            self._rollout.rollout(
                self._models,
                self._data,
                rows,
                inputs,
                control_spec=_INPUT,
                skip_checks=True,
                nstep=self.physics.substeps,
                state=self._trajectory,
                sensordata=self._readings,
            )
            rows[:] = self._trajectory[:, -1]

        return step

    def overflows(self) -> int:
        """See :meth:`Engine.overflows`: always 0, as MuJoCo's C engine has no fixed number of contacts or constraints.

        It takes them from one large arena; should that run out, the environment stops and shows up as not finite.
        """
        return 0

    def _memory(self) -> dict[str, torch.Tensor]:
        """All that is kept from step to step: a rollout begins without a warm start."""
        return {"rows": self._batch, "motor_torque": self._torque, "foot_wrench": self._foot_wrench}

    def snapshot(self) -> dict[str, torch.Tensor]:
        """See :meth:`Engine.snapshot`."""
        return {name: each.clone() for name, each in self._memory().items()}

    def restore(self, snapshot: dict[str, torch.Tensor]) -> None:
        """See :meth:`Engine.restore`."""
        take_over(snapshot, self._memory())
        self.state = self._read()


def _replace_plane(spec: mujoco.MjSpec, terrain: Terrain) -> None:
    """Put a height field of the same material in the place of the ground plane.

    To MuJoCo each triangle is a prism of its own, whose walls to its neighbours are as good as its top: its newer
    collision detection pushed feet along the shortest way out, often sideways, and they stuck. The older one pushes
    along the line from the prism's middle, which is up when the prism is deep.
    """
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_NATIVECCD.value
    length, width = terrain.extent
    heights = terrain.heights.double().numpy().T  # MuJoCo's rows run along y
    spec.add_hfield(
        name="terrain",
        nrow=heights.shape[0],
        ncol=heights.shape[1],
        size=[0.5 * length, 0.5 * width, max(np.ptp(heights), 1e-6), _DEPTH],  # MuJoCo stretches the data to this
        userdata=heights.ravel(),
    )
    for geom in list(spec.geoms):
        geom.gap = 0.0  # Newton asks for contacts up to 0.1 m away, which do nothing; here each would cost a search
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.type = mujoco.mjtGeom.mjGEOM_HFIELD
            geom.hfieldname = "terrain"
            geom.pos = [0.5 * length, 0.0, heights.min()]
        elif geom.type == mujoco.mjtGeom.mjGEOM_BOX:
            _add_studs(geom)


def _add_studs(foot: mujoco.MjsGeom) -> None:
    """Add a thin upright box within each corner of a foot; its shape and mass stay.

    MuJoCo finds one contact point per triangle and shape: without them a flat foot would rock on a point.
    """
    (x, y, z), (length, width, height) = foot.pos, foot.size
    for forward in (_STUD - length, length - _STUD):
        for left in (_STUD - width, width - _STUD):
            foot.parent.add_geom(
                type=foot.type,
                size=[_STUD, _STUD, height],
                pos=[x + forward, y + left, z],
                mass=0.0,
                contype=foot.contype,
                conaffinity=foot.conaffinity,
                friction=foot.friction,
                solref=foot.solref,
                solimp=foot.solimp,
                gap=foot.gap,
            )


def add_sensors(spec: mujoco.MjSpec, feet: Sequence[str], joints: Sequence[str]) -> None:
    """Add what :meth:`MujocoEngine._read_sensors` takes apart: sensors of both feet, then each joint's motor torque."""
    data = mujoco.mjtConDataField
    wanted = sum(1 << field.value for field in (data.mjCONDATA_FORCE, data.mjCONDATA_TORQUE, data.mjCONDATA_POS))
    for foot in feet:
        spec.add_sensor(
            name=f"{foot}_contact",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            objname=foot,
            intprm=[wanted, _NET_FORCE, 1],
        )
        spec.add_sensor(
            name=f"{foot}_origin",
            type=mujoco.mjtSensor.mjSENS_FRAMEPOS,
            objtype=mujoco.mjtObj.mjOBJ_XBODY,
            objname=foot,
        )
    for joint in joints:
        spec.add_sensor(
            name=f"{joint}_torque",
            type=mujoco.mjtSensor.mjSENS_JOINTACTFRC,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint,
        )
