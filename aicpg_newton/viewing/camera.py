"""Pictures of a stage by ray tracing, on CPU or GPU, without a display."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp
from newton.sensors import SensorCamera

from aicpg_newton.robot import rotations
from aicpg_newton.viewing.stage import GROUND_COLOUR, Stage

Window = tuple[slice, slice]
"""Rows and columns of a picture."""

BACKGROUND = (238, 240, 243)
"""8-bit sRGB behind the robots, and what the floor fades to far away."""

CELL = 1.0
"""Edge of a floor cell [m]."""

_LIGHT_CELL, _DARK_CELL = 0.93, 0.78
_FADE_START, _FADE_LENGTH = 6.0, 16.0
_SAMPLES = 4

_RELIEF = 1.2
"""How much darker the ground is made where it falls away from the light, per unit of slope."""

# From the camera's side, so that what faces the camera is lit and shadows fall behind the robots.
_LIGHT = torch.nn.functional.normalize(torch.tensor([-0.35, 0.45, -0.85]), dim=0)

_LINK_REACH = 0.32
"""No point of the robot is farther from the nearest link origin [m]."""


@dataclass
class Shot:
    """What a camera saw, each array of shape [height, width, ...]."""

    colour: np.ndarray
    """8-bit sRGB, shape [height, width, 3]."""
    shapes: np.ndarray
    """Shape seen by each pixel: an index of ``stage.shape_names``, or their number for the background."""
    depth: np.ndarray
    """Length of the ray to it [m]."""
    normal: np.ndarray
    """Its unit normal in the world, shape [height, width, 3]."""


class Photographer:
    """A ray-tracing camera with the light of the studio.

    Args:
        stage: What to photograph.
    """

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        red, green, blue = BACKGROUND
        self._sensor = SensorCamera(
            stage.model,
            default_clear_data=SensorCamera.ClearData(
                clear_color=red | green << 8 | blue << 16, clear_shape_index=len(stage.shape_names)
            ),
            default_render_config=SensorCamera.RenderConfig(
                enable_shadows=True, anti_aliasing=SensorCamera.AntiAliasing.MSAA
            ),
            load_textures=False,
        )
        self._sensor.create_default_light(direction=wp.vec3f(*_LIGHT.tolist()), color=(0.62, 0.61, 0.58))
        self._sensor.set_ambient_light((0.50, 0.51, 0.53), (0.34, 0.33, 0.32))
        self._world = wp.zeros(1, dtype=wp.int32, device=stage.model.device)

    def shoot(self, rays: Any, position: torch.Tensor, rotation: torch.Tensor) -> Shot:
        """Take a picture of the stage as it is posed now.

        Args:
            rays: Ray origins and directions in the camera frame (looking along -z, y up), shape
                [height, width, samples, 2].
            position: Camera position [m], world frame, shape [3].
            rotation: Camera rotation (x, y, z, w), shape [4].
        """
        model, state, sensor = self._stage.model, self._stage.state, self._sensor
        model.bvh_refit_shapes(state)
        view = wp.array([position.tolist() + rotation.tolist()], dtype=wp.transformf, device=model.device)
        height, width = rays.shape[:2]
        colour: Any = sensor.allocate_image_color(1, width, height)
        shapes: Any = sensor.allocate_image_shape_index(1, width, height)
        depth: Any = sensor.allocate_image_depth(1, width, height)
        normal: Any = sensor.allocate_image_normal(1, width, height)
        sensor.update(
            state,
            view,
            rays,
            color_image=colour,
            shape_index_image=shapes,
            depth_image=depth,
            normal_image=normal,
            world_indices=self._world,
        )
        packed = colour.numpy()[0].view(np.uint8).reshape(height, width, 4)
        return Shot(packed[..., :3].copy(), shapes.numpy()[0], depth.numpy()[0], normal.numpy()[0])


def facing(azimuth: float, elevation: float) -> torch.Tensor:
    """Camera rotation (x, y, z, w), shape [4].

    Args:
        azimuth: 0 looks along +y, so that forward (+x) is right in the picture; positive looks at the robot's front
            [rad].
        elevation: Height of the camera above what it looks at, as an angle [rad].
    """
    tilt = rotations.about_axis(torch.tensor([1.0, 0.0, 0.0]), torch.tensor(0.5 * math.pi - elevation))
    return rotations.multiply(rotations.about_z(torch.tensor(azimuth)), tilt)


def parallel_rays(width: int, height: int, pixel: float, horizon: float, elevation: float, device: Any) -> Any:
    """Rays of a camera without perspective, shape [height, width, 4, 2]; they begin in an upright plane.

    Args:
        width: Picture width [px].
        height: Picture height [px].
        pixel: Edge of a pixel [m].
        horizon: Row of the picture whose rays begin at the camera's own height [px from the top].
        elevation: The camera's, as in :func:`facing` [rad].
        device: Warp device of the rays.
    """
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.zeros((height, width, _SAMPLES, 2, 3), dtype=np.float32)
    # The first sample is the pixel's centre: it names the shape that the pixel belongs to.
    for sample, (dx, dy) in enumerate(((0.0, 0.0), (0.35, 0.12), (-0.12, 0.35), (-0.23, -0.35))):
        rays[:, :, sample, 0, 0] = (column + dx - 0.5 * width) * pixel
        rays[:, :, sample, 0, 1] = (horizon - row - dy) * pixel
    rays[..., 0, 2] = rays[..., 0, 1] * math.tan(elevation)
    rays[..., 1, 2] = -1.0
    return wp.array(rays, dtype=wp.vec3f, device=device)


def _pinhole_rays(width: int, height: int, field_of_view: float, samples: int, device: Any) -> Any:
    """Rays of a camera with perspective, shape [height, width, samples, 2]."""
    return SensorCamera.compute_camera_rays_pinhole(
        width, height, camera_fov=field_of_view, sample_count=samples, device=device
    )


class Studio:
    """A camera with perspective and a fixed direction over ground of cells of known size.

    Only the part of the picture that shows robots and their shadows is ray traced with smooth edges. Around it a plane
    is computed, and a terrain is traced with one ray a pixel. The checkerboard is computed: one of geometry or texture
    flickers in the distance, while here each pixel takes the mean over the patch of ground that it covers.

    Args:
        stage: What to photograph, on :attr:`Floor.FIXED`.
        width: Picture width [px].
        height: Picture height [px].
        field_of_view: Vertical field of view [rad].
        rotation: Camera rotation (x, y, z, w) without roll, shape [4].
    """

    def __init__(self, stage: Stage, width: int, height: int, field_of_view: float, rotation: torch.Tensor) -> None:
        self._stage = stage
        self._size = (height, width)
        self._rotation = rotation
        self._focal_length = 0.5 * height / math.tan(0.5 * field_of_view)  # [px]
        self._ground = stage.shape_names.index("ground")
        heights = torch.zeros(1) if stage.terrain is None else stage.terrain.heights
        self._lowest, self._highest = float(heights.min()), float(heights.max())
        self._photographer = Photographer(stage)
        self._rays, self._single_rays = (
            _pinhole_rays(width, height, field_of_view, samples, stage.model.device) for samples in (_SAMPLES, 1)
        )
        directions = wp.to_torch(self._single_rays)[:, :, 0, 1].cpu()
        world = rotations.rotate(rotation.expand(height, width, 4), directions).numpy()
        self._down = np.maximum(-world[..., 2], 1.0e-3)
        # Per metre that the ground lies below the camera: where a pixel sees it, how far away, and how much of it in x
        # and y the pixel covers.
        reach = world[..., :2] / self._down[..., None]
        patch = np.abs(np.gradient(reach, axis=0)) + np.abs(np.gradient(reach, axis=1))
        self._reach, self._patch = np.moveaxis(reach, 2, 0).copy(), np.moveaxis(patch, 2, 0).copy()
        self._distance = 1.0 / self._down
        if stage.terrain is None:
            horizon = int((world[..., 2] >= -1.0e-3).any(axis=1).sum())
            self._below = np.arange(height)[:, None].repeat(width, axis=1) >= horizon
            # A patch of floor in the sun, well away from the robots.
            away = stage.pelvis[0] + torch.tensor([50.0, 0.0, 0.0])
            sunny = self._photographer.shoot(self._rays[height - 1 :, :1], away, rotation)
            self._empty = np.where(self._below[..., None], sunny.colour[0, 0], np.array(BACKGROUND, dtype=np.uint8))

    def photograph(self, position: torch.Tensor, *, whole: bool = False) -> np.ndarray:
        """Take a picture of the stage as it is posed now.

        Args:
            position: Camera position [m], world frame, shape [3].
            whole: Ray trace all of the picture; slower, and on a plane the same picture.

        Returns:
            8-bit sRGB picture, shape [height, width, 3].
        """
        if self._stage.terrain is None:
            picture, ground = self._empty.copy(), self._below.copy()
            drop, slopes = np.float32(position[2]), 1.0
        else:
            picture, ground, drop, slopes = self._terrain(position)
        window = (slice(0, self._size[0]), slice(0, self._size[1])) if whole else self._window(position)
        if window is not None:
            near = self._photographer.shoot(self._rays[window], position, self._rotation)
            robot = near.shapes < self._ground
            picture[window] = near.colour
            picture[window][~robot & ~ground[window]] = BACKGROUND
            ground[window] &= ~robot
        self._paint(picture, ground, position, drop, slopes)
        return picture

    def _terrain(self, position: torch.Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The stage with one ray a pixel: picture, where it shows ground, and the last two arguments of _paint."""
        picture = np.full((*self._size, 3), BACKGROUND, dtype=np.uint8)
        ground, drop, slopes = np.zeros(self._size, dtype=bool), np.zeros(self._size), np.ones(self._size)
        # Long flat rays take longest, and what they meet has faded.
        clear = (self._distance * (float(position[2]) - self._highest)).min(axis=1) < _FADE_START + _FADE_LENGTH
        rows = slice(int(clear.argmax()), None)
        wide = self._photographer.shoot(self._single_rays[rows], position, self._rotation)
        picture[rows], ground[rows] = wide.colour, wide.shapes == self._ground
        drop[rows], slopes[rows] = wide.depth * self._down[rows], relief(wide.normal)
        return picture, ground, drop, slopes

    def _window(self, position: torch.Tensor) -> Window | None:
        """Part of the picture that surely holds the robots and their shadows; None if they are out of sight."""
        links = self._stage.links.reshape(-1, 3)
        shadows = links - _LIGHT * ((links[:, 2:] - self._lowest) / _LIGHT[2])
        points = torch.cat((links, shadows)) - position
        points = rotations.rotate(rotations.conjugate(self._rotation).expand(len(points), 4), points)
        depth = -points[:, 2]
        if bool((depth < 0.5).any()):  # around or behind the camera: no bound
            return slice(0, self._size[0]), slice(0, self._size[1])
        # A round shadow is stretched along the light by 1 / sin of its elevation.
        reach = _LINK_REACH * self._focal_length / (depth - _LINK_REACH)
        reach[len(links) :] /= -_LIGHT[2]
        column = 0.5 * self._size[1] + self._focal_length * points[:, 0] / depth
        row = 0.5 * self._size[0] - self._focal_length * points[:, 1] / depth
        left, right = int((column - reach).min()), int((column + reach).max()) + 1
        top, bottom = int((row - reach).min()), int((row + reach).max()) + 1
        left, right = max(left, 0), min(right, self._size[1])
        top, bottom = max(top, 0), min(bottom, self._size[0])
        return (slice(top, bottom), slice(left, right)) if top < bottom and left < right else None

    def _paint(
        self, picture: np.ndarray, ground: np.ndarray, position: torch.Tensor, drop: Any, slopes: np.ndarray | float
    ) -> None:
        """Paint the checkerboard on the ground, in place, keeping shadows.

        Args:
            picture: Picture without it, shape [height, width, 3].
            ground: Which pixels show the ground, shape [height, width].
            position: Camera position [m], shape [3].
            drop: How far the ground lies below the camera [m], one number or shape [height, width].
            slopes: Factor on the brightness, one number or shape [height, width].
        """
        x, y, _ = position.tolist()
        reach_x, reach_y = self._reach * drop
        tone = slopes * checkerboard(reach_x + x, reach_y + y, *(self._patch * drop))
        clear = 1.0 - np.clip((self._distance * drop - _FADE_START) / _FADE_LENGTH, 0.0, 1.0)
        background = np.array(BACKGROUND, dtype=np.float32)
        floor = picture * (clear * tone)[..., None] + background * (1.0 - clear)[..., None]
        np.copyto(picture, np.clip(floor, 0.0, 255.0).astype(np.uint8), where=ground[..., None])


def checkerboard(x: np.ndarray, y: np.ndarray, width_x: np.ndarray, width_y: np.ndarray) -> np.ndarray:
    """Factor on the ground's colour that makes a checkerboard of it: its mean over patches of the ground.

    Args:
        x: Middle of each patch along x [m].
        y: Middle along y [m].
        width_x: Width along x [m].
        width_y: Width along y [m].
    """
    pattern = _mean_stripes(x, width_x) * _mean_stripes(y, width_y)
    tone = 0.5 * (_LIGHT_CELL + _DARK_CELL) + 0.5 * (_LIGHT_CELL - _DARK_CELL) * pattern
    return tone / GROUND_COLOUR[1]


def relief(normal: np.ndarray) -> np.ndarray:
    """Factor on the ground's colour that makes its slopes plain, which the light alone does not, shape [...].

    Args:
        normal: Unit normals of the ground, shape [..., 3].
    """
    towards_light = -_LIGHT.numpy()
    return np.clip(1.0 + _RELIEF * normal[..., :2] @ towards_light[:2], 0.7, 1.05)


def _mean_stripes(coordinate: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Mean over intervals [m] of a square wave that is +1 and -1 on alternate cells."""
    half = np.maximum(0.5 / CELL * width, 0.0005)
    centre = coordinate / CELL

    def integral(at: np.ndarray) -> np.ndarray:
        return 1.0 - np.abs(at - 2.0 * np.floor(0.5 * at) - 1.0)

    return (integral(centre + half) - integral(centre - half)) / (2.0 * half)
