"""Pictures of a stage by ray tracing, on CPU or GPU, without a display."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
import warp as wp
from newton.sensors import SensorCamera

from aicpg_newton import rotations
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

# From the camera's side, so that what faces the camera is lit and shadows fall behind the robots.
_LIGHT = torch.nn.functional.normalize(torch.tensor([-0.35, 0.45, -0.85]), dim=0)

_LINK_REACH = 0.32
"""No point of the robot is farther from the nearest link origin [m]."""


class Photographer:
    """A ray-tracing camera with the light of the studio.

    Args:
        stage: What to photograph.
        rays: Ray origins and directions in the camera frame (looking along -z, y up), shape
            [height, width, samples, 2].
    """

    def __init__(self, stage: Stage, rays: Any) -> None:
        self.stage = stage
        self._rays = rays
        red, green, blue = BACKGROUND
        self._sensor = SensorCamera(
            stage.model,
            default_clear_data=SensorCamera.ClearData(
                clear_color=red | green << 8 | blue << 16, clear_shape_index=len(stage.shape_names)
            ),
            default_render_config=SensorCamera.RenderConfig(
                enable_shadows=True, anti_aliasing=SensorCamera.AntiAliasing.MSAA
            ),
        )
        self._sensor.create_default_light(direction=wp.vec3f(*_LIGHT.tolist()), color=(0.62, 0.61, 0.58))
        self._sensor.set_ambient_light((0.50, 0.51, 0.53), (0.34, 0.33, 0.32))
        self._world = wp.zeros(1, dtype=wp.int32, device=stage.model.device)

    def shoot(
        self, position: torch.Tensor, rotation: torch.Tensor, window: Window | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Take a picture of the stage as it is posed now.

        Args:
            position: Camera position [m], world frame, shape [3].
            rotation: Camera rotation (x, y, z, w), shape [4].
            window: Part of the picture to take; all of it by default.

        Returns:
            8-bit sRGB picture of the window, shape [height, width, 3], and the shape seen by each pixel, an index of
            ``stage.shape_names`` or their number for the background, shape [height, width].
        """
        model, state = self.stage.model, self.stage.state
        model.bvh_refit_shapes(state)
        view = wp.array([position.tolist() + rotation.tolist()], dtype=wp.transformf, device=model.device)
        rays = self._rays if window is None else self._rays[window[0], window[1]]
        height, width = rays.shape[:2]
        colour: Any = self._sensor.allocate_image_color(1, width, height)
        shapes: Any = self._sensor.allocate_image_shape_index(1, width, height)
        self._sensor.update(state, view, rays, color_image=colour, shape_index_image=shapes, world_indices=self._world)
        packed = colour.numpy()[0]
        return packed.view(np.uint8).reshape(height, width, 4)[..., :3].copy(), shapes.numpy()[0]


def facing(azimuth: float, elevation: float) -> torch.Tensor:
    """Camera rotation (x, y, z, w), shape [4].

    Args:
        azimuth: 0 looks along +y, so that forward (+x) is right in the picture; positive looks at the robot's front
            [rad].
        elevation: Height of the camera above what it looks at, as an angle [rad].
    """
    tilt = rotations.about_axis(torch.tensor([1.0, 0.0, 0.0]), torch.tensor(0.5 * math.pi - elevation))
    return rotations.multiply(rotations.about_z(torch.tensor(azimuth)), tilt)


def parallel_rays(width: int, height: int, pixel: float, horizon: float, device: Any) -> Any:
    """Rays of a camera without perspective, shape [height, width, 4, 2].

    Args:
        width: Picture width [px].
        height: Picture height [px].
        pixel: Edge of a pixel [m].
        horizon: Row of the picture at the camera's own height [px from the top].
        device: Warp device of the rays.
    """
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.zeros((height, width, _SAMPLES, 2, 3), dtype=np.float32)
    # The first sample is the pixel's centre: it names the shape that the pixel belongs to.
    for sample, (dx, dy) in enumerate(((0.0, 0.0), (0.35, 0.12), (-0.12, 0.35), (-0.23, -0.35))):
        rays[:, :, sample, 0, 0] = (column + dx - 0.5 * width) * pixel
        rays[:, :, sample, 0, 1] = (horizon - row - dy) * pixel
    rays[..., 1, 2] = -1.0
    return wp.array(rays, dtype=wp.vec3f, device=device)


class Studio:
    """A camera with perspective and a fixed direction over a floor of cells of known size.

    Only the part of the picture that shows robots and their shadows is ray traced; the floor around it is computed, as
    is its checkerboard: one of geometry or texture flickers in the distance, while here each pixel takes the mean over
    the patch of floor that it covers.

    Args:
        stage: What to photograph, on :attr:`Ground.PLANE`.
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
        rays: Any = SensorCamera.compute_camera_rays_pinhole(
            width, height, camera_fov=field_of_view, sample_count=_SAMPLES, device=stage.model.device
        )
        self._photographer = Photographer(stage, rays)
        directions = wp.to_torch(rays)[:, :, 0, 1].cpu()
        world = rotations.rotate(rotation.expand(height, width, 4), directions).numpy()
        self._horizon = int((world[..., 2] >= -1.0e-3).any(axis=1).sum())
        down = np.maximum(-world[..., 2:], 1.0e-3)
        # Per metre of camera height: where a pixel meets the floor, and how much of it the pixel covers in x and y.
        reach = world[..., :2] / down
        patch = np.abs(np.gradient(reach, axis=0)) + np.abs(np.gradient(reach, axis=1))
        below = slice(self._horizon, None)
        self._reach, self._patch = np.moveaxis(reach[below], 2, 0).copy(), np.moveaxis(patch[below], 2, 0).copy()
        self._distance = 1.0 / down[below, :, 0]
        # A patch of floor in the sun, well away from the robots.
        sunny, _ = self._photographer.shoot(
            stage.pelvis[0] + torch.tensor([50.0, 0.0, 0.0]), rotation, (slice(height - 1, height), slice(0, 1))
        )
        self._empty = np.empty((height, width, 3), dtype=np.uint8)
        self._empty[: self._horizon] = BACKGROUND
        self._empty[self._horizon :] = sunny[0, 0]

    def photograph(self, position: torch.Tensor, *, whole: bool = False) -> np.ndarray:
        """Take a picture of the stage as it is posed now.

        Args:
            position: Camera position [m], world frame, shape [3].
            whole: Ray trace all of the picture; slower, and the same picture.

        Returns:
            8-bit sRGB picture, shape [height, width, 3].
        """
        window = (slice(0, self._size[0]), slice(0, self._size[1])) if whole else self._window(position)
        picture = self._empty.copy()
        robot = np.zeros(self._size, dtype=bool)
        if window is not None:
            traced, shapes = self._photographer.shoot(position, self._rotation, window)
            robot[window] = shapes < self._ground
            above = slice(0, max(0, self._horizon - window[0].start))
            traced[above][shapes[above] == self._ground] = BACKGROUND
            picture[window] = traced
        self._paint_floor(picture[self._horizon :], robot[self._horizon :], position)
        return picture

    def _window(self, position: torch.Tensor) -> Window | None:
        """Part of the picture that surely holds the robots and their shadows; None if they are out of sight."""
        links = self._stage.links.reshape(-1, 3)
        shadows = links - _LIGHT * (links[:, 2:] / _LIGHT[2])
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

    def _paint_floor(self, picture: np.ndarray, robot: np.ndarray, position: torch.Tensor) -> None:
        """Paint the checkerboard on the rows below the horizon, in place, keeping shadows and robots."""
        x, y, height = position.tolist()
        (reach_x, reach_y), (patch_x, patch_y) = self._reach * height, self._patch * height
        pattern = _mean_stripes(reach_x + x, patch_x) * _mean_stripes(reach_y + y, patch_y)
        tone = 0.5 * (_LIGHT_CELL + _DARK_CELL) + 0.5 * (_LIGHT_CELL - _DARK_CELL) * pattern
        clear = 1.0 - np.clip((self._distance * height - _FADE_START) / _FADE_LENGTH, 0.0, 1.0)
        background = np.array(BACKGROUND, dtype=np.float32)
        floor = picture * (clear * tone / GROUND_COLOUR[1])[..., None] + background * (1.0 - clear)[..., None]
        np.copyto(picture, np.clip(floor, 0.0, 255.0).astype(np.uint8), where=~robot[..., None])


def _mean_stripes(coordinate: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Mean over intervals [m] of a square wave that is +1 and -1 on alternate cells."""
    half = np.maximum(0.5 / CELL * width, 0.0005)
    centre = coordinate / CELL

    def integral(at: np.ndarray) -> np.ndarray:
        return 1.0 - np.abs(at - 2.0 * np.floor(0.5 * at) - 1.0)

    return (integral(centre + half) - integral(centre - half)) / (2.0 * half)
