"""Let humanoids move and keep count: frames for pictures, and speed, falls and episode length for the table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import torch

from aicpg_newton.device import torch_threads
from aicpg_newton.gait.cpg import PatternNetwork, advance_phase
from aicpg_newton.gait.poses import gait_pose
from aicpg_newton.learning.policy import Agent
from aicpg_newton.robot.humanoid import CONTROL_DT, NUM_JOINTS
from aicpg_newton.viewing.desk import Readings

if TYPE_CHECKING:
    from aicpg_newton.env.environment import Environment


def no_action(observed: torch.Tensor) -> torch.Tensor:
    """The agent that does nothing, so that the CPG is alone."""
    return observed.new_zeros(len(observed), NUM_JOINTS)


def share_out(num_envs: int, groups: int) -> torch.Tensor:
    """Group of each environment, as evenly as possible, shape [num_envs]."""
    return torch.arange(num_envs) * groups // num_envs


@dataclass
class Frame:
    """Poses of all humanoids at one control step."""

    root_position: torch.Tensor
    """World position of the pelvis [m], shape [num_envs, 3]."""
    root_rotation: torch.Tensor
    """Pelvis rotation (x, y, z, w), shape [num_envs, 4]."""
    joint_position: torch.Tensor
    """Joint angles [rad], shape [num_envs, 28]."""
    phase: torch.Tensor
    """Phase of the rhythm generator [rad], shape [num_envs]."""
    frequency: torch.Tensor
    """Stride frequency of the step [Hz], shape [num_envs]."""
    episode: torch.Tensor
    """Number of episodes the environment has ended, shape [num_envs]."""
    readings: Readings | None = None
    """What a page shows of them, where one is looked at."""


@dataclass
class Tally:
    """Counts over a roll-out, each tensor of shape [num_envs]."""

    frequency: torch.Tensor
    """Stride frequency [Hz]."""
    follows_frequency: bool = True
    """Whether that does anything; if not, the table does not name it."""
    steps: int = 0
    """Control steps done."""
    distance: torch.Tensor = field(init=False)
    """Way made along x [m]."""
    falls: torch.Tensor = field(init=False)
    """Falls."""
    turned_away: torch.Tensor = field(init=False)
    """Episodes that ended as the robot had turned away from its target direction, without a fall."""

    def __post_init__(self) -> None:
        self.distance = torch.zeros_like(self.frequency)
        self.falls = torch.zeros_like(self.frequency, dtype=torch.long)
        self.turned_away = torch.zeros_like(self.falls)

    def add(self, forward_velocity: torch.Tensor, fallen: torch.Tensor, turned: torch.Tensor) -> None:
        """Count one control step.

        Args:
            forward_velocity: Velocity along x [m/s], shape [num_envs].
            fallen: Environments that fell, shape [num_envs].
            turned: Environments that turned away, shape [num_envs].
        """
        self.steps += 1
        self.distance += torch.nan_to_num(forward_velocity) * CONTROL_DT
        self.falls += fallen
        self.turned_away += turned

    def speed(self, env: int) -> float:
        """Mean speed of a robot so far [m/s]."""
        return float(self.distance[env]) / (max(self.steps, 1) * CONTROL_DT)

    def table(self) -> str:
        """Mean speed, falls, turnings away and episode length, a line per frequency."""
        duration = max(self.steps, 1) * CONTROL_DT
        head = f"{'f [Hz]':>8}{'environments':>14}{'speed [m/s]':>13}{'falls':>8}{'turned away':>13}{'episode [s]':>13}"
        lines = [head]
        for frequency in self.frequency.unique().tolist():
            mine = self.frequency == frequency
            count, falls, turned = int(mine.sum()), int(self.falls[mine].sum()), int(self.turned_away[mine].sum())
            episode = duration * count / (count + falls + turned)
            speed = float(self.distance[mine].mean()) / duration
            name = f"{frequency:.2f}" if self.follows_frequency else "-"
            lines.append(f"{name:>8}{count:14d}{speed:13.2f}{falls:8d}{turned:13d}{episode:13.1f}")
        return "\n".join(lines)


@torch.no_grad()  # not inference_mode: engines keep tensors that a later roll-out changes
def physical_frames(environment: Environment, agent: Agent, steps: int, tally: Tally) -> Iterator[Frame]:
    """Let the agent control the environment; yields the frame after every control step, before resets.

    Args:
        environment: The environment, at the start of its episodes.
        agent: What gives the actions.
        steps: Number of control steps.
        tally: Counts to add to.
    """
    episode = torch.zeros(environment.num_envs, dtype=torch.long, device=environment.device)
    observed = environment.get_observations()
    with torch_threads(1):
        for _ in range(steps):
            observed, _, dones, _ = environment.step(agent(observed["policy"]))
            outcome = environment.outcome
            tally.add(outcome.state.root_linear_velocity[:, 0], outcome.fallen, outcome.off_course)
            yield Frame(
                root_position=outcome.state.root_position,
                root_rotation=outcome.state.root_rotation,
                joint_position=outcome.state.joint_position,
                phase=outcome.phase,
                frequency=outcome.commands.frequency,
                episode=episode.clone(),
            )
            episode += dones


@torch.inference_mode()
def kinematic_frames(pattern: PatternNetwork, frequency: torch.Tensor, steps: int, tally: Tally) -> Iterator[Frame]:
    """Play the imitated gait back without physics, at the gait's own speed.

    Args:
        pattern: The pattern network S.
        frequency: Stride frequency per humanoid [Hz], shape [num_envs].
        steps: Number of control steps.
        tally: Counts to add to.
    """
    phase, never = torch.zeros_like(frequency), torch.zeros_like(frequency, dtype=torch.bool)
    speed = pattern.nominal_speed(frequency)
    for step in range(1, steps + 1):
        phase = advance_phase(phase, frequency)
        pose = gait_pose(pattern, phase, frequency)
        pose.root_position[:, 0] += speed * step * CONTROL_DT
        tally.add(speed, never, never)
        yield Frame(pose.root_position, pose.root_rotation, pose.joint_position, phase, frequency, never.long())
