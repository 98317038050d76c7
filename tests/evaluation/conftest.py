"""What tests of evaluations share: a robot whose motion is known."""

import math
from dataclasses import replace

import pytest
import torch

from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.robot import humanoid


@pytest.fixture
def glider(puppet):
    """Class of an engine whose robot glides along x at 1 + 0.5 i m/s in environment i, with steps of 40 and 20."""

    class Glider(puppet):
        def __init__(self, num_envs: int, terrain: Terrain | None = None) -> None:
            super().__init__(num_envs, terrain)
            self.ticks = 0
            self.fall_at: dict[int, int] = {}  # environment to step
            self.turn_at: dict[int, int] = {}
            self.pushed: list[torch.Tensor | None] = []

        def swing(self) -> torch.Tensor:
            """Joint angles: hips that swing, a little, once in 60 steps, opposite to one another; shape [28]."""
            angles = torch.zeros(humanoid.NUM_JOINTS)
            swing = 1e-3 * math.sin(2 * math.pi * self.ticks / 60)
            for name, angle in (("right_hip_y", swing), ("left_hip_y", -swing)):
                angles[humanoid.joint_index(name)] = angle
            return angles

        def step(self, target, target_velocity, torque, *, push=None) -> None:
            super().step(target, target_velocity, torque, push=push)
            self.pushed.append(push)
            position = self.state.root_position.clone()
            position[:, 0] += (1.0 + 0.5 * torch.arange(self.num_envs)) / 60
            position[:, 2] = 0.88
            for env, step in self.fall_at.items():
                if step == self.ticks:
                    position[env, 2] = 0.3
            rotation = torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(self.num_envs, 1)
            for env, step in self.turn_at.items():
                if step == self.ticks:
                    rotation[env] = torch.tensor([0.0, 0.0, 1.0, 0.0])  # backwards
            self.ticks += 1
            force = torch.zeros(self.num_envs, 2, 3)
            # A stride of 60 steps; each foot stands for 24, so 2 x 6 steps are flight.
            force[:, 0, 2] = 480.0 if self.ticks % 60 < 24 else 0.0
            force[:, 1, 2] = 480.0 if 30 <= self.ticks % 60 < 54 else 0.0
            power = torch.zeros(self.num_envs, humanoid.NUM_JOINTS)
            power[:, 3] = 50.0
            self.state = replace(
                self.state,
                root_position=position,
                root_rotation=rotation,
                joint_position=self.swing().expand(self.num_envs, -1),
                joint_velocity=power / 25.0,
                joint_torque=power,
                foot_force=force,
            )

    return Glider
