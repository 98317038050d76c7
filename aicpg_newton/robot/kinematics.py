"""Forward kinematics of the humanoid in torch, without an engine: for resets, pictures and motion references."""

# MuJoCo's extension module has no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import mujoco
import numpy as np
import torch

from aicpg_newton.device import MadeOnce
from aicpg_newton.errors import UserError
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import FOOT_NAMES, JOINT_NAMES, LINK_NAMES, MJCF_PATH, NUM_JOINTS
from aicpg_newton.robot.mjcf import checked


@dataclass(frozen=True)
class Skeleton:
    """The kinematic tree in the order of :data:`LINK_NAMES` (parents before children)."""

    parents: tuple[int, ...]
    offsets: torch.Tensor
    """Joint origin of each link in its parent's frame [m], shape [13, 3]; the root's is zero."""
    joints: tuple[tuple[int, ...], ...]
    """Joint indices of each link, outermost hinge first."""
    axes: torch.Tensor
    """Hinge axes in the link frame, shape [28, 3]."""
    ranges: torch.Tensor
    """Lower and upper joint limits [rad], shape [28, 2]."""
    sole_corners: torch.Tensor
    """The four lower corners of each foot's box in the foot frame [m], shape [2, 4, 3]."""
    masses: torch.Tensor
    """Mass of each link [kg], shape [13]."""
    mass_centres: torch.Tensor
    """Centre of mass of each link in the link frame [m], shape [13, 3]."""


@cache
def skeleton() -> Skeleton:
    """Read the tree from ``assets/humanoid.xml``.

    Raises:
        UserError: The file does not hold the 13 links and 28 joints that :mod:`aicpg_newton.robot.humanoid` names.
    """
    spec = checked(MJCF_PATH)
    bodies = [body for body in spec.bodies if body.name != "world"]
    links = tuple(body.name for body in bodies)
    hinges = {joint.name: joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE}
    if links != LINK_NAMES or set(hinges) != set(JOINT_NAMES):
        raise UserError(
            f"{MJCF_PATH.name} holds {len(bodies)} links and {len(hinges)} joints that do not match the"
            f" {len(LINK_NAMES)} links and {NUM_JOINTS} joints named in humanoid.py; make the two agree"
        )

    def numbers(values: Sequence) -> torch.Tensor:
        return torch.from_numpy(np.array(values)).float()

    offsets = numbers([body.pos for body in bodies])
    offsets[0] = 0.0
    corners = []
    for foot in FOOT_NAMES:
        (box,) = spec.body(foot).geoms
        assert box.type == mujoco.mjtGeom.mjGEOM_BOX
        (x, y, z), (sx, sy, sz) = box.pos, box.size
        corners.append([[x + i * sx, y + j * sy, z - sz] for i in (-1, 1) for j in (-1, 1)])

    def middle(geom: mujoco.MjsGeom) -> np.ndarray:
        """Spheres and boxes give their centre, capsules their two ends."""
        return geom.pos if np.isnan(geom.fromto[0]) else 0.5 * (geom.fromto[:3] + geom.fromto[3:])

    masses = [[geom.mass for geom in body.geoms] for body in bodies]
    centres = [
        np.average([middle(geom) for geom in body.geoms], axis=0, weights=each)
        for body, each in zip(bodies, masses, strict=True)
    ]
    return Skeleton(
        parents=tuple(-1 if body.parent.name == "world" else links.index(body.parent.name) for body in bodies),
        offsets=offsets,
        joints=tuple(
            tuple(JOINT_NAMES.index(joint.name) for joint in body.joints if joint.name in hinges) for body in bodies
        ),
        axes=numbers([hinges[name].axis for name in JOINT_NAMES]),
        ranges=torch.deg2rad(numbers([hinges[name].range for name in JOINT_NAMES])),
        sole_corners=numbers(corners),
        masses=numbers([sum(each) for each in masses]),
        mass_centres=numbers(centres),
    )


@MadeOnce
def skeleton_on(device: torch.device, dtype: torch.dtype) -> Skeleton:
    """The same with its tensors on a device and of a type, made once."""
    tree = skeleton()
    moved = {name: each.to(device, dtype) for name, each in vars(tree).items() if isinstance(each, torch.Tensor)}
    return replace(tree, **moved)


@dataclass(frozen=True)
class _Tree:
    """The kinematic tree level by level, as tensors of one device and type."""

    axes: torch.Tensor
    slots: torch.Tensor
    """Hinges of each link, outermost first, filled up with 28, which turns nothing; shape [13, 3]."""
    levels: tuple[tuple[torch.Tensor, torch.Tensor, torch.Tensor], ...]
    """Below the root: links of a level, their parents' places in the level above, and their offsets [m]."""
    still: torch.Tensor
    """The rotation that turns nothing, shape [4]."""
    place: torch.Tensor
    """Where each link stands when the levels are put one behind the other, shape [13]."""


@MadeOnce
def _tree(device: torch.device, dtype: torch.dtype) -> _Tree:
    tree = skeleton()
    slots = [(*joints, *(NUM_JOINTS,) * (3 - len(joints))) for joints in tree.joints]
    levels, level = [], [0]
    order = [0]
    while children := [link for link, parent in enumerate(tree.parents) if parent in level]:
        above = [level.index(tree.parents[link]) for link in children]
        offsets = tree.offsets[children].to(device, dtype)
        levels.append((torch.tensor(children, device=device), torch.tensor(above, device=device), offsets))
        order += children
        level = children
    return _Tree(
        axes=tree.axes.to(device, dtype),
        slots=torch.tensor(slots, device=device),
        levels=tuple(levels),
        still=torch.tensor((0.0, 0.0, 0.0, 1.0), device=device, dtype=dtype),
        place=torch.argsort(torch.tensor(order, device=device)),
    )


@MadeOnce
def _places(links: tuple[str, ...], device: torch.device, dtype: torch.dtype) -> torch.Tensor:
    """Where links stand when the levels are put one behind the other, shape [len(links)]."""
    return _tree(device, dtype).place[torch.tensor([LINK_NAMES.index(name) for name in links], device=device)]


def forward_kinematics(
    root_position: torch.Tensor,
    root_rotation: torch.Tensor,
    joint_position: torch.Tensor,
    links: tuple[str, ...] = LINK_NAMES,
) -> tuple[torch.Tensor, torch.Tensor]:
    """World poses of links.

    Args:
        root_position: Pelvis frame's origin in the world [m], shape [..., 3].
        root_rotation: Pelvis rotation (x, y, z, w), shape [..., 4].
        joint_position: Joint angles [rad] in the order of :data:`JOINT_NAMES`, shape [..., 28].
        links: Links wanted.

    Returns:
        Link origins [m], shape [..., len(links), 3], and link rotations (x, y, z, w), shape [..., len(links), 4].
    """
    tree = _tree(joint_position.device, joint_position.dtype)
    hinges = rotations.about_axis(tree.axes.expand(*joint_position.shape, 3), joint_position)
    still = tree.still.expand(*hinges.shape[:-2], 1, 4)
    # All links of a level at once: the cost is in the number of operations, not in their size.
    outer, middle, inner = torch.cat((hinges, still), dim=-2)[..., tree.slots, :].unbind(dim=-2)
    turns = rotations.multiply(rotations.multiply(outer, middle), inner)
    position, rotation = root_position.unsqueeze(-2), root_rotation.unsqueeze(-2)
    positions, orientations = [position], [rotation]
    for level, above, offsets in tree.levels:
        position, rotation = position[..., above, :], rotation[..., above, :]
        position = position + rotations.rotate(rotation, offsets.expand_as(position))
        rotation = rotations.multiply(rotation, turns[..., level, :])
        positions.append(position)
        orientations.append(rotation)
    wanted = _places(links, joint_position.device, joint_position.dtype)
    return torch.cat(positions, dim=-2)[..., wanted, :], torch.cat(orientations, dim=-2)[..., wanted, :]


def sole_corners(
    root_position: torch.Tensor, root_rotation: torch.Tensor, joint_position: torch.Tensor
) -> torch.Tensor:
    """World positions [m] of the sole corners, shape [..., 2, 4, 3] (right, left); arguments as above."""
    positions, orientations = forward_kinematics(root_position, root_rotation, joint_position, FOOT_NAMES)
    corners = skeleton_on(joint_position.device, joint_position.dtype).sole_corners
    corners = corners.expand(*joint_position.shape[:-1], *corners.shape)
    rotation = orientations.unsqueeze(-2).expand(*corners.shape[:-1], 4)
    return positions.unsqueeze(-2) + rotations.rotate(rotation, corners)


def sole_heights(
    root_position: torch.Tensor, root_rotation: torch.Tensor, joint_position: torch.Tensor
) -> torch.Tensor:
    """World height [m] of the lowest sole corner of each foot, shape [..., 2] (right, left); arguments as above."""
    return sole_corners(root_position, root_rotation, joint_position)[..., 2].amin(dim=-1)


def centre_of_mass(
    root_position: torch.Tensor, root_rotation: torch.Tensor, joint_position: torch.Tensor
) -> torch.Tensor:
    """World position of the whole body's centre of mass [m], shape [..., 3]; arguments as above."""
    tree = skeleton_on(joint_position.device, joint_position.dtype)
    positions, orientations = forward_kinematics(root_position, root_rotation, joint_position)
    offsets, share = tree.mass_centres, tree.masses / tree.masses.sum()
    return ((positions + rotations.rotate(orientations, offsets.expand_as(positions))) * share.unsqueeze(1)).sum(-2)
