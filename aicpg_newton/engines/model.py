"""The humanoid as a Newton model: written once in MJCF, built here for every engine."""

# MuJoCo's extension module has no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import newton
import torch
import warp as wp
from newton.solvers import SolverMuJoCo

import aicpg_newton.engines.warp_log  # noqa: F401
from aicpg_newton.engines.interface import Physics
from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.errors import UserError
from aicpg_newton.robot.humanoid import FOOT_NAMES, GRAVITY, JOINT_NAMES, LINK_NAMES, MJCF_PATH, NUM_JOINTS, Motors
from aicpg_newton.robot.mjcf import checked

ROOT_COORDINATES = 7
"""Position and quaternion of the free joint come first in Newton's joint coordinates."""

ROOT_DOFS = 6
"""Linear and angular velocity of the free joint come first in Newton's joint velocities."""


@dataclass(frozen=True)
class Layout:
    """Where the package's joints and links stand in one world of a Newton model."""

    joints: tuple[int, ...]
    """Newton's position, among the 28 hinges, of each joint of :data:`JOINT_NAMES`."""
    links: tuple[int, ...]
    """Newton's body of each link of :data:`LINK_NAMES`."""
    foot_shapes: tuple[int, ...]
    """Newton's shape of each foot of :data:`FOOT_NAMES`."""


def build(
    num_envs: int, motors: Motors, physics: Physics, mjcf: Path = MJCF_PATH, terrain: Terrain | None = None
) -> tuple[newton.ModelBuilder, Layout]:
    """Assemble ``num_envs`` humanoids, each in a world of its own, over one ground that all of them share.

    Args:
        num_envs: Number of worlds.
        motors: Gains, limits, damping and armature per joint.
        physics: Simulation settings.
        mjcf: Geometry; its joints and links may stand in any order.
        terrain: Shape of the ground; None for a plane.

    Returns:
        The builder, ready to be finalized on a device, and the layout of one world.

    Raises:
        UserError: :func:`~aicpg_newton.robot.mjcf.checked` refuses the MJCF, or it does not hold the humanoid's 28
            joints and 13 links.
    """
    spec = checked(mjcf)
    robot = newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=(0.0, 0.0, -GRAVITY))
    SolverMuJoCo.register_custom_attributes(robot)
    robot.add_mjcf(str(mjcf), enable_self_collisions=False)
    layout = _layout(robot, spec, mjcf.name)
    # MuJoCo takes the larger friction of two touching shapes, so robot and ground get the same.
    robot.shape_material_mu = [physics.friction] * robot.shape_count
    # In Newton's own order: the table's row of the joint that stands at each hinge.
    row_of_hinge = torch.argsort(torch.tensor(layout.joints))
    hinges = slice(ROOT_DOFS, ROOT_DOFS + NUM_JOINTS)
    for attribute, values in (
        (robot.joint_target_ke, motors.position_gain),
        (robot.joint_target_kd, motors.velocity_gain),
        (robot.joint_effort_limit, motors.torque_limit),
        (robot.joint_damping, motors.damping),
        (robot.joint_armature, motors.armature),
    ):
        attribute[hinges] = values.cpu()[row_of_hinge].tolist()
    # Eq. 4 has a velocity target too; the solver clamps the sum of both actuators to the effort limit.
    robot.joint_target_mode[hinges] = [newton.JointTargetMode.POSITION_VELOCITY] * NUM_JOINTS

    builder = newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=(0.0, 0.0, -GRAVITY))
    SolverMuJoCo.register_custom_attributes(builder)
    builder.replicate(robot, num_envs)
    if terrain is None:
        builder.add_ground_plane(cfg=newton.ModelBuilder.ShapeConfig(mu=physics.friction))
    else:
        _add_terrain(builder, terrain, physics)
    return builder, layout


def _add_terrain(builder: newton.ModelBuilder, terrain: Terrain, physics: Physics) -> None:
    """Add the uneven ground as a height field: solid below its surface, unlike a mesh, through which limbs fall."""
    length, width = terrain.extent
    heights = terrain.heights.cpu().numpy().T  # Newton's rows run along y
    field = newton.Heightfield(heights, *heights.shape, hx=0.5 * length, hy=0.5 * width)
    # Only what touches is a contact: those Newton would note within a gap of 0.1 m fill the buffers and do nothing.
    builder.shape_gap = [0.0] * builder.shape_count
    builder.add_shape_heightfield(
        xform=wp.transform((0.5 * length, 0.0, 0.0), wp.quat_identity()),
        heightfield=field,
        cfg=newton.ModelBuilder.ShapeConfig(mu=physics.friction, gap=0.0),
    )


def make_solver(model: newton.Model, physics: Physics, **options: Any) -> SolverMuJoCo:
    """The constraint solver, with the same settings for every engine.

    Args:
        model: What :func:`build` assembled, finalized on a device.
        physics: Simulation settings.
        **options: What an engine needs beside them, as arguments of ``SolverMuJoCo``.
    """
    return SolverMuJoCo(
        model,
        solver="newton",
        integrator="implicitfast",
        cone="pyramidal",
        impratio=1.0,
        iterations=physics.iterations,
        ls_iterations=physics.ls_iterations,
        nconmax=physics.max_contacts,
        njmax=physics.max_constraints,
        **options,
    )


def _layout(robot: newton.ModelBuilder, spec: mujoco.MjSpec, source: str) -> Layout:
    """Find joints, links and feet by name; Newton merges the hinges of a link into one joint, in the file's order."""

    def names(labels: list[str]) -> list[str]:
        return [label.rsplit("/", 1)[-1] for label in labels]

    links, shapes = names(robot.body_label), names(robot.shape_label)
    hinges_of_link = {
        body.name: [joint.name for joint in body.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
        for body in spec.bodies
    }
    hinges = [hinge for child in robot.joint_child for hinge in hinges_of_link[links[child]]]
    if sorted(hinges) != sorted(JOINT_NAMES) or sorted(links) != sorted(LINK_NAMES):
        raise UserError(
            f"{source} holds {len(hinges)} joints and {len(links)} links that are not the humanoid's {NUM_JOINTS}"
            f" joints and {len(LINK_NAMES)} links; use the names of aicpg_newton/robot/humanoid.py"
        )
    return Layout(
        joints=tuple(hinges.index(name) for name in JOINT_NAMES),
        links=tuple(links.index(name) for name in LINK_NAMES),
        foot_shapes=tuple(shapes.index(name) for name in FOOT_NAMES),
    )
