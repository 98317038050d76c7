"""What a control step led to, for whoever judges, plays or evaluates it."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from aicpg_newton.engines import RobotState
from aicpg_newton.env.commands import Commands


@dataclass
class StepOutcome:
    """What a control step led to, before any environment was reset; each tensor has shape [num_envs, ...]."""

    state: RobotState
    """Robot state at the end of the step."""
    phase: torch.Tensor
    """Phase of the rhythm generator at the end of the step [rad], shape [num_envs]."""
    commands: Commands
    """What the robots were told in the step."""
    torque: torch.Tensor
    """Torque that the network asked for in the step [N m], shape [num_envs, 28]: of AI-CPG the reflex tau_r."""
    ground_height: torch.Tensor
    """World height of the ground below the pelvis [m], shape [num_envs]."""
    reward_terms: dict[str, torch.Tensor]
    """Weighted and scaled reward terms; zero where the robot fell."""
    fallen: torch.Tensor
    """Fell, or diverged."""
    fault: torch.Tensor
    """What is wrong with the simulation of this robot, from :func:`aicpg_newton.env.faults.cause_of`; 0 for nothing."""
    off_course: torch.Tensor
    """Turned too far from the target without falling."""
    timed_out: torch.Tensor
    """Reached the end of the episode or the edge of the terrain, without failing."""

    @property
    def diverged(self) -> torch.Tensor:
        """Whether the simulation of a robot has gone wrong, bool, shape [num_envs]."""
        return self.fault > 0
