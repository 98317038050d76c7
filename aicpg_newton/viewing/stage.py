"""The stage: a Newton model of humanoids that are posed, never simulated."""

from __future__ import annotations

from enum import Enum

import newton
import numpy as np
import torch
import warp as wp

import aicpg_newton.engines.warp_log  # noqa: F401
from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.robot.humanoid import LINK_NAMES, MJCF_PATH, NUM_JOINTS
from aicpg_newton.robot.kinematics import forward_kinematics, sole_heights

RIGHT_COLOUR = (0.84, 0.33, 0.16)
"""sRGB of the right limbs (vermilion); beside the blue it stays apart for colour-blind eyes and in grey prints."""

LEFT_COLOUR = (0.16, 0.42, 0.68)
"""sRGB of the left limbs (blue)."""

TRUNK_COLOUR = (0.80, 0.78, 0.74)
"""sRGB of pelvis, torso and head."""

GROUND_COLOUR = (0.87, 0.87, 0.88)
"""sRGB of the ground."""

LINE_COLOUR = (0.62, 0.63, 0.66)
"""sRGB of the lines of a treadmill, or of every other square metre of one that is uneven."""

LANE_WIDTH = 1.5
"""Distance between robots side by side [m]."""

_FARTHEST = 1.0e5
"""A root farther out than this [m] is a simulation that has blown up."""

_TREADMILL = 12
"""Half the edge of a treadmill [m]."""

_WORLD = -1
"""Newton's body of what stands still."""

_WRAP = 6.0
"""Length of a treadmill in use [m], whole metres: a robot that leaves it at the front comes back in at the rear."""


class Floor(Enum):
    """Where the ground is while robots move over it."""

    NONE = 0
    """There is none."""
    FIXED = 1
    """At rest: an endless plane at z = 0, or the terrain."""
    TREADMILL = 2
    """It slides under robot 0, which stays where a still camera looks. Instead of the plane there is a platform with
    lines every metre, on which a robot more than 3 m ahead of robot 0 comes back 3 m behind it and the other way round,
    so that all stay in the picture, whatever their speeds; on a terrain the others are where they are."""


class Stage:
    """Humanoids in one rendered scene.

    Environments share one coordinate frame. On the plane each robot is drawn in a lane of its own along y, robot 0
    leftmost (largest y), the lanes centred on y = 0; on a terrain robots are drawn where they are.

    Args:
        num_robots: Number of humanoids.
        floor: Where the ground is.
        terrain: Shape of the ground; None for a plane.
        device: Warp device of the model; the preferred one (a GPU where there is one) by default.

    Attributes:
        model: The Newton model.
        state: Its state; only ``body_q`` is meaningful.
        terrain: Shape of the ground on the CPU, or None.
        shape_names: Name of every shape, as in ``assets/humanoid.xml``; the ground's is ``ground``.
    """

    def __init__(
        self,
        num_robots: int = 1,
        *,
        floor: Floor = Floor.FIXED,
        terrain: Terrain | None = None,
        device: str | None = None,
    ) -> None:
        self.num_robots = num_robots
        self.terrain = None if terrain is None else terrain.to("cpu")
        robot = newton.ModelBuilder(up_axis=newton.Axis.Z)
        robot.add_mjcf(str(MJCF_PATH), enable_self_collisions=False)
        links = [_name(label) for label in robot.body_label]
        shapes = [_name(label) for label in robot.shape_label]
        robot.shape_color[:] = [_colour(name) for name in shapes]
        # The MJCF leaves the head floating; a neck is for the eye only.
        neck = wp.transform(wp.vec3(0.0, 0.0, 0.05), wp.quat_identity())
        robot.add_shape_capsule(links.index("head"), xform=neck, radius=0.045, half_height=0.05, color=TRUNK_COLOUR)
        scene = newton.ModelBuilder(up_axis=newton.Axis.Z)
        for _ in range(num_robots):
            scene.add_builder(robot)
        if floor is not Floor.NONE:
            body = scene.add_body(label="treadmill") if floor is Floor.TREADMILL else _WORLD
            if self.terrain is not None:
                # The camera paints cells of its own, and a usd file would name the texture's place on this machine.
                _add_terrain(scene, body, self.terrain, textured=floor is Floor.TREADMILL)
            elif floor is Floor.TREADMILL:
                _add_platform(scene, body)
            else:
                scene.add_ground_plane(label="ground", color=GROUND_COLOUR)
        self.shape_names = [_name(label) for label in scene.shape_label]
        self.model = scene.finalize(device=device or wp.get_preferred_device())
        self.state = self.model.state()
        assert self.state.body_q is not None
        bodies = wp.to_torch(self.state.body_q)
        robot_bodies = num_robots * len(LINK_NAMES)
        self._bodies = bodies[:robot_bodies].view(num_robots, len(LINK_NAMES), 7)
        self._treadmill = bodies[robot_bodies:]
        self._belt = Tracker(gain=0.06) if floor is Floor.TREADMILL else None
        self._link_of_body = [LINK_NAMES.index(link) for link in links]
        lanes = torch.arange(num_robots) - 0.5 * (num_robots - 1)
        self._offset = torch.zeros(num_robots, 3)
        if self.terrain is None:
            self._offset[:, 1] = -LANE_WIDTH * lanes
        # Until the first usable pose, robots stand on the ground with all angles zero.
        upright = torch.tensor([0.0, 0.0, 0.0, 1.0])
        height = -sole_heights(torch.zeros(3), upright, torch.zeros(NUM_JOINTS)).min()
        self._root_position = torch.zeros(num_robots, 3)
        self._root_position[:, 2] = height + self.ground_height(self._root_position)
        self._root_rotation = upright.repeat(num_robots, 1)
        self._joint_position = torch.zeros(num_robots, NUM_JOINTS)
        self._write()

    def ground_height(self, position: torch.Tensor) -> torch.Tensor:
        """World height of the ground below positions of shape [..., 3] [m], shape [...]."""
        return torch.zeros_like(position[..., 2]) if self.terrain is None else self.terrain.height(position)

    def pose(self, root_position: torch.Tensor, root_rotation: torch.Tensor, joint_position: torch.Tensor) -> None:
        """Pose the robots; one whose pose is not finite keeps its last finite pose.

        Args:
            root_position: Pelvis positions [m], world frame, shape [n, 3] with n >= num_robots; more are ignored.
            root_rotation: Pelvis rotations (x, y, z, w), shape [n, 4].
            joint_position: Joint angles [rad], shape [n, 28].
        """
        rows = slice(self.num_robots)
        position, rotation, joints = (
            values.detach()[rows].to("cpu", torch.float32) for values in (root_position, root_rotation, joint_position)
        )
        norm = rotation.norm(dim=1, keepdim=True)
        usable = torch.isfinite(torch.cat((position, rotation, joints), dim=1)).all(dim=1, keepdim=True)
        usable &= (norm > 0.5) & (position.abs().amax(dim=1, keepdim=True) < _FARTHEST)
        self._root_position = torch.where(usable, position, self._root_position)
        self._root_rotation = torch.where(usable, rotation / norm, self._root_rotation)
        self._joint_position = torch.where(usable, joints, self._joint_position)
        self._write()

    @property
    def pelvis(self) -> torch.Tensor:
        """Pelvis positions as drawn, lanes included [m], shape [num_robots, 3]."""
        return self._root_position + self._offset

    @property
    def links(self) -> torch.Tensor:
        """Origins of all links as drawn [m], shape [num_robots, 13, 3], in Newton's order."""
        return self._bodies[..., :3].cpu()

    def _write(self) -> None:
        # Forward kinematics in torch gives the links in the package's own order, whatever order Newton keeps joints in.
        positions, orientations = forward_kinematics(self.pelvis, self._root_rotation, self._joint_position)
        if self._belt is not None:
            below = self._root_position[0].clone()
            below[2] = self.ground_height(below)
            origin = self._belt.follow(below)
            if self.terrain is None:
                ahead = (self._root_position - origin)[:, :1]
                positions = positions - (_WRAP * torch.round(ahead / _WRAP) * torch.tensor([1.0, 0.0, 0.0])).unsqueeze(
                    1
                )
                # A metre further on, the lines look the same.
                slide = -torch.remainder(origin, 1.0)
            else:
                slide = -origin
            positions = positions - origin
            self._treadmill.copy_(torch.cat((slide, torch.tensor([0.0, 0.0, 0.0, 1.0]))))
        self._bodies.copy_(torch.cat((positions, orientations), dim=-1)[:, self._link_of_body])


class Tracker:
    """Smooth position of something that moves: no lag at constant speed, little of the bobbing of a stride.

    Args:
        gain: Share of the deviation taken over in each step, in (0, 1).
    """

    def __init__(self, gain: float) -> None:
        self._gain = gain
        self._rate_gain = gain * gain / (2.0 - gain)  # critically damped
        self._position: torch.Tensor | None = None
        self._rate = torch.zeros(3)  # [m/step]
        self._fresh = True

    def follow(self, position: torch.Tensor) -> torch.Tensor:
        """Smoothed position [m] after one more step, shape [3]; a jump of over 1 m is followed at once."""
        if self._position is not None:
            predicted = self._position + self._rate
            deviation = position - predicted
            if float(deviation.norm()) < 1.0:
                # The second step gives the first idea of the speed: a robot often starts at full speed.
                gain, rate_gain = (1.0, 1.0) if self._fresh else (self._gain, self._rate_gain)
                self._position = predicted + gain * deviation
                self._rate = self._rate + rate_gain * deviation
                self._fresh = False
                return self._position
        self._position, self._rate, self._fresh = position.clone(), torch.zeros(3), True
        return self._position


def _name(label: str) -> str:
    return label.rsplit("/", 1)[-1]


def _colour(shape: str) -> tuple[float, float, float]:
    if "clavicle" in shape:
        return TRUNK_COLOUR
    return RIGHT_COLOUR if shape.startswith("right_") else LEFT_COLOUR if shape.startswith("left_") else TRUNK_COLOUR


def _add_platform(scene: newton.ModelBuilder, body: int) -> None:
    """Add a platform with lines every metre."""
    edge, thickness = float(_TREADMILL), 0.05
    below = wp.transform(wp.vec3(0.0, 0.0, -thickness - 0.003), wp.quat_identity())
    scene.add_shape_box(body, xform=below, hx=edge, hy=edge, hz=thickness, label="ground", color=GROUND_COLOUR)
    for line in range(-_TREADMILL, _TREADMILL + 1):
        for x, y, hx, hy in ((line, 0.0, 0.012, edge), (0.0, line, edge, 0.012)):
            at = wp.transform(wp.vec3(float(x), float(y), -0.003), wp.quat_identity())
            scene.add_shape_box(body, xform=at, hx=hx, hy=hy, hz=0.003, color=LINE_COLOUR)


def _add_terrain(scene: newton.ModelBuilder, body: int, terrain: Terrain, *, textured: bool) -> None:
    """Add the terrain's own triangles, if textured as a checkerboard of 1 m cells."""
    vertices = terrain.vertices()
    mesh = newton.Mesh(vertices, terrain.triangles().ravel(), uvs=0.5 * vertices[:, :2], compute_inertia=False)
    if textured:
        tones = np.round(255.0 * np.array([GROUND_COLOUR, LINE_COLOUR])).astype(np.uint8)
        mesh.texture = tones[np.kron([[0, 1], [1, 0]], np.ones((32, 32), dtype=int))]  # two by two cells, repeated
    # For the eye only: what Newton needs for collisions takes seconds at this size.
    seen = newton.ModelBuilder.ShapeConfig(density=0.0, has_shape_collision=False, has_particle_collision=False)
    scene.add_shape_mesh(body, mesh=mesh, cfg=seen, label="ground", color=GROUND_COLOUR)
