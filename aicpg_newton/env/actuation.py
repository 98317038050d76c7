"""What stands between the network's actions and the motors, a class for each way to control a humanoid.

It decides what an action does, which blocks the network sees and how an episode starts.
"""

from __future__ import annotations

import math
from typing import ClassVar, Generic, NamedTuple, TypeVar

import torch

from aicpg_newton.engines.interface import BodyState, RobotState
from aicpg_newton.env.commands import Commands
from aicpg_newton.env.observations import BODY, PATTERN, Block
from aicpg_newton.env.style import BLOCKS as STYLE
from aicpg_newton.env.style import StyleView
from aicpg_newton.env.task import ImitationTask, ReflexTask, Task
from aicpg_newton.env.view import View
from aicpg_newton.gait.cpg import PatternNetwork, pd_torque
from aicpg_newton.gait.poses import gait_start
from aicpg_newton.robot.humanoid import CONTROL_DT, NUM_JOINTS, Motors
from aicpg_newton.robot.kinematics import skeleton_on, sole_heights

_Task = TypeVar("_Task", bound=Task)


class MotorCommand(NamedTuple):
    """What an engine is told for a control step, each of shape [num_envs, 28]."""

    target: torch.Tensor
    """Target angles of the PD law [rad]."""
    target_velocity: torch.Tensor
    """Their rate [rad/s]."""
    torque: torch.Tensor
    """Torque on top of the PD law [N m]."""


class Actuation(Generic[_Task]):
    """The base of all ways to control.

    Args:
        task: What is to be learned.
        pattern: The pattern network S.
        motors: Gains and limits, the same as the engine's.
        num_envs: Number of environments.
        generator: Random numbers for start states.
    """

    blocks: ClassVar[tuple[Block[View], ...]] = BODY
    """What the network sees."""
    style_blocks: ClassVar[tuple[Block[StyleView], ...]] = ()
    """What a discriminator sees; none where there is none."""
    target: torch.Tensor | None = None
    """theta_t of the CPG [rad], shape [num_envs, 28], where there is one."""
    target_velocity: torch.Tensor | None = None
    """Its rate over the coming control step [rad/s]; None from the end of a step until what comes is known."""

    def __init__(
        self, task: _Task, pattern: PatternNetwork, motors: Motors, num_envs: int, generator: torch.Generator
    ) -> None:
        self.task = task
        self.pattern = pattern
        self.motors = motors
        self.generator = generator
        self.torque = torch.zeros(num_envs, NUM_JOINTS, device=generator.device)
        """Torque that the network asked for in the last step [N m], shape [num_envs, 28]."""
        self.torque_unit = motors.torque_limit
        """Unit of that torque in rewards and observations [N m], shape [28]."""
        self.at_rest = torch.zeros_like(self.torque)

    def follow(self, phase: torch.Tensor, commands: Commands) -> None:
        """Take note of the rhythm generator's phase [rad], shape [num_envs], and of what the robots are told."""

    def go_on(self) -> None:
        """The rhythm generator has gone on by a control step, as it was told."""

    def command(self, actions: torch.Tensor, state: RobotState) -> MotorCommand:
        """Turn actions, shape [num_envs, 28], into what the engine is told, given the state before the step."""
        raise NotImplementedError

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


class TorqueActuation(Actuation[ReflexTask]):
    """The PPO baseline: the network's torques alone, no CPG and no motion capture (paper, Sec. III-A).

    Torques are scaled as the reflex's are; actions beyond 1 reach the unit. With all of the range at an action
    of 1, exploring costs so much energy (R_e) that the shortest episode is the best.
    """

    _START_ANGLE = 0.1
    """Largest deviation of a joint from upright standing at the start [rad]."""

    def __init__(
        self, task: ReflexTask, pattern: PatternNetwork, motors: Motors, num_envs: int, generator: torch.Generator
    ) -> None:
        super().__init__(task, pattern, motors, num_envs, generator)
        if task.reflex.unit == "gear":
            self.torque_unit = motors.gear

    def command(self, actions: torch.Tensor, state: RobotState) -> MotorCommand:
        """See :meth:`Actuation.command`."""
        unit = self.torque_unit
        self.torque = (self.task.reflex.torque_share * unit * actions).clamp(-unit, unit)
        return MotorCommand(self.at_rest, self.at_rest, self.torque)

    def start(self, phase: torch.Tensor, frequency: torch.Tensor, speed_share: torch.Tensor) -> BodyState:
        """See :meth:`Actuation.start`: standing still, feet on the ground, every joint a little off."""
        rows, device = len(phase), phase.device
        noise = 2.0 * torch.rand(rows, NUM_JOINTS, generator=self.generator, device=device) - 1.0
        low, high = skeleton_on(device, noise.dtype).ranges.unbind(dim=1)
        angles = (self._START_ANGLE * noise).clamp(low, high)
        still = torch.zeros(rows, 3, device=device)
        rotation = torch.cat((still, torch.ones(rows, 1, device=device)), dim=1)
        position = still.clone()
        position[:, 2] = -sole_heights(still, rotation, angles).amin(dim=1)
        return BodyState(position, rotation, still, still, angles, torch.zeros_like(angles))


class PatternActuation(TorqueActuation):
    """AI-CPG: the pattern network's angles through the PD law, and the network's torque, the reflex (Sec. II-A)."""

    blocks = (*BODY, *PATTERN)
    target: torch.Tensor

    def follow(self, phase: torch.Tensor, commands: Commands) -> None:
        """See :meth:`Actuation.follow`."""
        self.target, self.target_velocity = self.pattern.target(phase, commands.frequency)

    def go_on(self) -> None:
        """See :meth:`Actuation.go_on`: where the rate has led, for which S need not be asked again."""
        assert self.target_velocity is not None
        self.target, self.target_velocity = self.target + CONTROL_DT * self.target_velocity, None

    def command(self, actions: torch.Tensor, state: RobotState) -> MotorCommand:
        """See :meth:`Actuation.command`: tau = tau_g + tau_r."""
        assert self.target_velocity is not None
        # Made anew, as torch.compile of torch 2.11 cannot hand out what _replace makes.
        return MotorCommand(self.target, self.target_velocity, super().command(actions, state).torque)

    def start(self, phase: torch.Tensor, frequency: torch.Tensor, speed_share: torch.Tensor) -> BodyState:
        """See :meth:`Actuation.start`: the gait at this phase and frequency."""
        return gait_start(self.pattern, phase, frequency, self.pattern.nominal_speed(frequency) * speed_share)


class TargetActuation(Actuation[ImitationTask]):
    """The AMP baseline: the network's actions are target angles of the PD law, as published for this humanoid."""

    style_blocks = STYLE

    _REACH = 0.7
    """An action of 1 lies this share of the joint's range from its middle (Isaac Gym's AMP humanoid)."""

    def __init__(
        self, task: ImitationTask, pattern: PatternNetwork, motors: Motors, num_envs: int, generator: torch.Generator
    ) -> None:
        super().__init__(task, pattern, motors, num_envs, generator)
        low, high = skeleton_on(self.torque.device, self.torque.dtype).ranges.unbind(dim=1)
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

    def start(self, phase: torch.Tensor, frequency: torch.Tensor, speed_share: torch.Tensor) -> BodyState:
        """See :meth:`Actuation.start`: the imitated gait at its own frequency and speed."""
        own = torch.full_like(frequency, self._gait.frequency)
        return gait_start(self.pattern, phase, own, torch.full_like(own, self._gait.speed))
