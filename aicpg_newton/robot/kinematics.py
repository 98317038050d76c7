"""Forward kinematics of the humanoid in torch, without an engine: for resets, pictures and motion references."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from functools import cache

import torch

from aicpg_newton.errors import UserError
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import FOOT_NAMES, JOINT_NAMES, LINK_NAMES, MJCF_PATH, NUM_JOINTS


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
    root = ElementTree.parse(MJCF_PATH).getroot().find("worldbody/body")
    assert root is not None
    bodies: dict[str, tuple[ElementTree.Element, int]] = {}

    def visit(body: ElementTree.Element, parent: int) -> None:
        bodies[body.attrib["name"]] = (body, parent)
        index = len(bodies) - 1
        for child in body.findall("body"):
            visit(child, index)

    visit(root, -1)
    hinges = {joint.attrib["name"]: joint for body, _ in bodies.values() for joint in body.findall("joint")}
    if tuple(bodies) != LINK_NAMES or set(hinges) != set(JOINT_NAMES):
        raise UserError(
            f"{MJCF_PATH.name} holds {len(bodies)} links and {len(hinges)} joints that do not match the"
            f" {len(LINK_NAMES)} links and {NUM_JOINTS} joints named in humanoid.py; make the two agree"
        )

    def numbers(text: str) -> list[float]:
        return [float(word) for word in text.split()]

    offsets = [numbers(body.attrib["pos"]) if parent >= 0 else [0.0, 0.0, 0.0] for body, parent in bodies.values()]
    corners = []
    for foot in FOOT_NAMES:
        box = bodies[foot][0].find("geom")
        assert box is not None and box.attrib["type"] == "box"
        (x, y, z), (sx, sy, sz) = numbers(box.attrib["pos"]), numbers(box.attrib["size"])
        corners.append([[x + i * sx, y + j * sy, z - sz] for i in (-1, 1) for j in (-1, 1)])

    def middle(geom: ElementTree.Element) -> torch.Tensor:
        """Spheres and boxes give their centre, capsules their two ends."""
        ends = numbers(geom.attrib.get("fromto") or geom.attrib["pos"])
        return torch.tensor(ends).reshape(-1, 3).mean(dim=0)

    geoms = [body.findall("geom") for body, _ in bodies.values()]
    weights = [torch.tensor([float(geom.attrib["mass"]) for geom in each]) for each in geoms]
    centres = [torch.stack([middle(geom) for geom in each]) for each in geoms]
    return Skeleton(
        parents=tuple(parent for _, parent in bodies.values()),
        offsets=torch.tensor(offsets),
        joints=tuple(
            tuple(JOINT_NAMES.index(joint.attrib["name"]) for joint in body.findall("joint"))
            for body, _ in bodies.values()
        ),
        axes=torch.tensor([numbers(hinges[name].attrib["axis"]) for name in JOINT_NAMES]),
        ranges=torch.deg2rad(torch.tensor([numbers(hinges[name].attrib["range"]) for name in JOINT_NAMES])),
        sole_corners=torch.tensor(corners),
        masses=torch.stack([each.sum() for each in weights]),
        mass_centres=torch.stack([each @ where / each.sum() for each, where in zip(weights, centres, strict=True)]),
    )


@dataclass(frozen=True)
class _Tree:
    """The kinematic tree level by level, as tensors of one device and type."""

    axes: torch.Tensor
    slots: torch.Tensor
    """Hinges of each link, outermost first, filled up with 28, which turns nothing; shape [13, 3]."""
    levels: tuple[tuple[torch.Tensor, torch.Tensor, torch.Tensor], ...]
    """Below the root: links of a level, their parents' places in the level above, and their offsets [m]."""
    place: torch.Tensor
    """Where each link stands when the levels are put one behind the other, shape [13]."""


@cache
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
        place=torch.argsort(torch.tensor(order, device=device)),
    )


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
    still = hinges.new_tensor((0.0, 0.0, 0.0, 1.0)).expand(*hinges.shape[:-2], 1, 4)
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
    wanted = tree.place[[LINK_NAMES.index(name) for name in links]]
    return torch.cat(positions, dim=-2)[..., wanted, :], torch.cat(orientations, dim=-2)[..., wanted, :]


def sole_corners(
    root_position: torch.Tensor, root_rotation: torch.Tensor, joint_position: torch.Tensor
) -> torch.Tensor:
    """World positions [m] of the sole corners, shape [..., 2, 4, 3] (right, left); arguments as above."""
    positions, orientations = forward_kinematics(root_position, root_rotation, joint_position, FOOT_NAMES)
    corners = skeleton().sole_corners.to(joint_position)
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
    tree = skeleton()
    positions, orientations = forward_kinematics(root_position, root_rotation, joint_position)
    offsets, share = tree.mass_centres.to(joint_position), (tree.masses / tree.masses.sum()).to(joint_position)
    return ((positions + rotations.rotate(orientations, offsets.expand_as(positions))) * share.unsqueeze(1)).sum(-2)
