"""Start states of episodes, drawn in advance, so that a reset is a matter of masks."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import torch

from aicpg_newton.engines.interface import BodyState
from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.env.actuation import Actuation
from aicpg_newton.env.task import Resets
from aicpg_newton.robot.kinematics import sole_corners


class Starts:
    """A start state for every robot, ready before it is needed, and drawn anew every few steps.

    To draw only for those that have just fallen would ask the device which they are, and wait for the answer in every
    step. A robot that falls twice between two drawings starts in the same way again.

    Args:
        resets: Range of the start speeds.
        actuation: How an episode starts on flat ground.
        terrain: The ground; None for a plane.
        generator: Random numbers, on the device of the robots.
    """

    EVERY = 16
    """Steps from one drawing to the next."""

    def __init__(
        self, resets: Resets, actuation: Actuation, terrain: Terrain | None, generator: torch.Generator
    ) -> None:
        self._resets, self._actuation, self._terrain, self._generator = resets, actuation, terrain, generator
        self._age = 0

    def draw(self, frequency: torch.Tensor) -> None:
        """Draw start states: a random phase of the gait, its joint velocities, a share of its forward speed.

        Args:
            frequency: Stride frequency that each robot will start with [Hz], shape [num_envs].
        """
        self.phase = self._uniform(frequency, 0.0, 2 * math.pi)
        """Phase of the rhythm generator [rad], shape [num_envs]."""
        speed_share = self._uniform(frequency, self._resets.minimum_speed, self._resets.maximum_speed)
        self._start = self._actuation.start(self.phase, frequency, speed_share)
        if self._terrain is not None:
            self._place = torch.stack([self._uniform(frequency, 0.0, 1.0) for _ in range(2)], dim=1)
            self._find_soles()
        self._age = 0

    def _find_soles(self) -> None:
        """Where the soles' corners are on flat ground."""
        start = self._start
        self._soles = sole_corners(start.root_position, start.root_rotation, start.joint_position).flatten(1, 2)

    def state_dict(self) -> dict[str, Any]:
        """What is ready, and for how long."""
        place = None if self._terrain is None else self._place
        return {"phase": self.phase, "start": vars(self._start), "place": place, "age": self._age}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from :meth:`state_dict`."""
        self.phase, self._start, self._age = state["phase"], BodyState(**state["start"]), state["age"]
        if self._terrain is not None:
            self._place = state["place"]
            self._find_soles()

    def grow_old(self, frequency: torch.Tensor) -> None:
        """A step has passed; arguments as for :meth:`draw`."""
        self._age += 1
        if self._age >= self.EVERY:
            self.draw(frequency)

    def states(self, level: torch.Tensor) -> BodyState:
        """The start states of all robots.

        On terrain a robot starts anywhere in the starting area of its level, standing on the surface, with no sole
        below it.

        Args:
            level: Level of the terrain, shape [num_envs].
        """
        start = self._start
        if self._terrain is None:
            return start
        place = self._terrain.starts(level, self._place)
        height = self._terrain.height(start.root_position[:, :2] + place)
        shift = torch.cat((place, height.unsqueeze(1)), dim=1)
        position, soles = start.root_position + shift, self._soles + shift.unsqueeze(1)
        sunk = (self._terrain.height(soles) - soles[..., 2]).amax(dim=1).clamp_min(0.0)
        position[:, 2] += sunk
        return replace(start, root_position=position)

    def _uniform(self, like: torch.Tensor, low: float, high: float) -> torch.Tensor:
        """Random numbers in [low, high), shape as ``like``."""
        return low + (high - low) * torch.rand(like.shape, generator=self._generator, device=like.device)
