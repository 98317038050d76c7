"""What stands between the network's actions and the motors, a class for each way to control a humanoid.

It decides what an action does, what the network sees besides its body, which reward term comes on top of the common
ones and how an episode starts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch

from aicpg_newton.engines.interface import BodyState, RobotState
from aicpg_newton.env import rewards
from aicpg_newton.env.style import style_state
from aicpg_newton.env.task import Task
from aicpg_newton.gait.cpg import PatternNetwork, pd_torque
from aicpg_newton.gait.poses import gait_start
from aicpg_newton.robot.humanoid import NUM_JOINTS, Motors
from aicpg_newton.robot.kinematics import skeleton, sole_heights


class MotorCommand(NamedTuple):
    """What an engine is told for a control step, each of shape [num_envs, 28]."""

    target: torch.Tensor
    """Target angles of the PD law [rad]."""
    target_velocity: torch.Tensor
    """Their rate [rad/s]."""
    torque: torch.Tensor
    """Torque on top of the PD law [N m]."""


class Actuation:
    """Torques of the network on top of a PD law; the base of all ways to control.

    Args:
        task: What is to be learned.
        pattern: The pattern network S.
        motors: Gains and limits, the same as the engine's.
        num_envs: Number of environments.
        generator: Random numbers for start states.
    """

    def __init__(
        self, task: Task, pattern: PatternNetwork, motors: Motors, num_envs: int, generator: torch.Generator
    ) -> None:
        self.task = task
        self.pattern = pattern
        self.motors = motors
        self.generator = generator
        self.torque = torch.zeros(num_envs, NUM_JOINTS, device=generator.device)
        """Torque that the network asked for in the last step [N m], shape [num_envs, 28]."""
        self.at_rest = torch.zeros_like(self.torque)

    def follow(self, phase: torch.Tensor, frequency: torch.Tensor) -> None:
        """Take note of the rhythm generator: phase [rad] and stride frequency [Hz], shape [num_envs]."""

    def command(self, actions: torch.Tensor, state: RobotState) -> MotorCommand:
        """Turn actions, shape [num_envs, 28], into what the engine is told, given the state before the step."""
        limit = self.motors.torque_limit
        self.torque = (self.task.reflex.torque_share * limit * actions).clamp(-limit, limit)
        return MotorCommand(self.at_rest, self.at_rest, self.torque)

    def observe(self, state: RobotState) -> tuple[torch.Tensor, ...]:
        """Blocks that the network sees besides its body and its last torque, each of shape [num_envs, ...]."""
        return ()

    def style(self, state: RobotState, ground_height: torch.Tensor) -> torch.Tensor | None:
        """What a discriminator sees, shape [num_envs, ...]; None where there is none."""
        return None

    def reward(self, state: RobotState, target_direction: torch.Tensor) -> dict[str, torch.Tensor]:
        """Terms that come with this control, each of shape [num_envs]; named as in ``RewardWeights``."""
        return {}

    def start(self, phase: torch.Tensor, frequency: torch.Tensor, speed_share: torch.Tensor) -> BodyState:
        """Start states of some robots on flat ground at the origin.

        Args:
            phase: Phase of the rhythm generator [rad], shape [rows].
            frequency: Stride frequency [Hz], shape [rows].
            speed_share: Forward speed as a share of the gait's own, shape [rows].
        """
        raise NotImplementedError

    def forget(self, mask: torch.Tensor) -> None:
        """Drop what belongs to the last episode of the masked environments, bool, shape [num_envs]."""
        self.torque = self.torque.masked_fill(mask.unsqueeze(1), 0.0)


class PatternActuation(Actuation):
    """AI-CPG: the pattern network's angles through the PD law, and the reflex torque (paper, Sec. II-A)."""

    target: torch.Tensor
    """theta_t [rad], shape [num_envs, 28]."""
    target_velocity: torch.Tensor

    def follow(self, phase: torch.Tensor, frequency: torch.Tensor) -> None:
        """See :meth:`Actuation.follow`."""
        self.target, self.target_velocity = self.pattern.target(phase, frequency)

    def command(self, actions: torch.Tensor, state: RobotState) -> MotorCommand:
        """See :meth:`Actuation.command`: tau = tau_g + tau_r."""
        return super().command(actions, state)._replace(target=self.target, target_velocity=self.target_velocity)

    def observe(self, state: RobotState) -> tuple[torch.Tensor, ...]:
        """See :meth:`Actuation.observe`: theta_t, and tau_g in units of the limit."""
        torque = pd_torque(
            self.target,
            self.target_velocity,
            state.joint_position,
            state.joint_velocity,
            position_gain=self.motors.position_gain,
            velocity_gain=self.motors.velocity_gain,
        )
        return self.target, torque / self.motors.torque_limit

    def reward(self, state: RobotState, target_direction: torch.Tensor) -> dict[str, torch.Tensor]:
        """See :meth:`Actuation.reward`: R_g."""
        settings = self.task.rewards
        error = rewards.pattern_error(self.target, state.joint_position, settings.pattern_error)
        return {"pattern_tracking": rewards.pattern_tracking(error, settings.pattern_error_bound)}

    def start(self, phase: torch.Tensor, frequency: torch.Tensor, speed_share: torch.Tensor) -> BodyState:
        """See :meth:`Actuation.start`: the gait at this phase and frequency."""
        return gait_start(self.pattern, phase, frequency, self.pattern.nominal_speed(frequency) * speed_share)


class TorqueActuation(Actuation):
    """The PPO baseline: the network's torques alone, no CPG and no motion capture (paper, Sec. III-A).

    Torques are scaled as the reflex's are; actions beyond 1 reach the joint's limit. With all of the range at an action
    of 1, exploring costs so much energy (R_e) that the shortest episode is the best.
    """

    _START_ANGLE = 0.1
    """Largest deviation of a joint from upright standing at the start [rad]."""

    def reward(self, state: RobotState, target_direction: torch.Tensor) -> dict[str, torch.Tensor]:
        """See :meth:`Actuation.reward`: R_t."""
        speed = rewards.target_velocity(state.root_linear_velocity, target_direction)
        return {"target_speed": rewards.target_speed(speed, self.task.target_speed)}

    def start(self, phase: torch.Tensor, frequency: torch.Tensor, speed_share: torch.Tensor) -> BodyState:
        """See :meth:`Actuation.start`: standing still, feet on the ground, every joint a little off."""
        rows, device = len(phase), phase.device
        noise = 2.0 * torch.rand(rows, NUM_JOINTS, generator=self.generator, device=device) - 1.0
        low, high = skeleton().ranges.to(noise).unbind(dim=1)
        angles = (self._START_ANGLE * noise).clamp(low, high)
        still = torch.zeros(rows, 3, device=device)
        rotation = torch.tensor([0.0, 0.0, 0.0, 1.0], device=device).expand(rows, 4)
        position = still.clone()
        position[:, 2] = -sole_heights(still, rotation, angles).amin(dim=1)
        return BodyState(position, rotation, still, still, angles, torch.zeros_like(angles))


class TargetActuation(Actuation):
    """The AMP baseline: the network's actions are target angles of the PD law, as published for this humanoid."""

    _REACH = 0.7
    """An action of 1 lies this share of the joint's range from its middle (Isaac Gym's AMP humanoid)."""

    def __init__(
        self, task: Task, pattern: PatternNetwork, motors: Motors, num_envs: int, generator: torch.Generator
    ) -> None:
        super().__init__(task, pattern, motors, num_envs, generator)
        low, high = skeleton().ranges.to(self.torque).unbind(dim=1)
        self._middle, self._reach = 0.5 * (low + high), self._REACH * (high - low)
        self._gait = pattern.gait(task.reference)

    def command(self, actions: torch.Tensor, state: RobotState) -> MotorCommand:
        """See :meth:`Actuation.command`; the torque that counts is that of the PD law before the step."""
        target = (self._middle + self._reach * actions).clamp(-math.pi, math.pi)
        limit = self.motors.torque_limit
        asked = pd_torque(
            target,
            self.at_rest,
            state.joint_position,
            state.joint_velocity,
            position_gain=self.motors.position_gain,
            velocity_gain=self.motors.velocity_gain,
        )
        self.torque = asked.clamp(-limit, limit)
        return MotorCommand(target, self.at_rest, self.at_rest)

    def style(self, state: RobotState, ground_height: torch.Tensor) -> torch.Tensor:
        """See :meth:`Actuation.style`."""
        return style_state(state, ground_height)

    def start(self, phase: torch.Tensor, frequency: torch.Tensor, speed_share: torch.Tensor) -> BodyState:
        """See :meth:`Actuation.start`: the imitated gait at its own frequency and speed."""
        own = torch.full_like(frequency, self._gait.frequency)
        return gait_start(self.pattern, phase, own, torch.full_like(own, self._gait.speed))
