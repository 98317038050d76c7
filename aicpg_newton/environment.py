"""One control step in order: reflex and CPG torques, physics, phase, falls, rewards, resets, observations."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from aicpg_newton import observations, rewards, rotations
from aicpg_newton.cpg import CONTROL_DT, PatternNetwork, advance_phase, pd_torque
from aicpg_newton.engines import Engine, RobotState
from aicpg_newton.errors import UserError
from aicpg_newton.humanoid import NUM_JOINTS, Motors
from aicpg_newton.kinematics import sole_heights
from aicpg_newton.task import RewardWeights, Task


@dataclass
class StepOutcome:
    """What a control step led to, before any environment was reset; each tensor has shape [num_envs, ...]."""

    state: RobotState
    """Robot state at the end of the step."""
    phase: torch.Tensor
    """Phase of the rhythm generator at the end of the step [rad], shape [num_envs]."""
    reflex_torque: torch.Tensor
    """tau_r of the step [N m], shape [num_envs, 28]."""
    reward_terms: dict[str, torch.Tensor]
    """Weighted and scaled reward terms; zero where the robot fell."""
    fallen: torch.Tensor
    """Fell, or left the finite numbers."""
    off_course: torch.Tensor
    """Turned too far from the target without falling."""
    timed_out: torch.Tensor
    """Reached the end of the episode."""


class Environment(VecEnv):
    """Humanoids driven by a pattern network and corrected by the reflex torques of a policy; rsl_rl's ``VecEnv``.

    Args:
        task: What is to be learned.
        engine: Physics of ``num_envs`` humanoids.
        pattern: The pattern network S.
        motors: Gains and limits, the same as the engine's.
        seed: Seed of phases, start speeds and pushes.
    """

    def __init__(self, task: Task, engine: Engine, pattern: PatternNetwork, motors: Motors, *, seed: int = 0) -> None:
        task.validate()
        self.task = task
        self.engine = engine
        self.num_envs = engine.num_envs
        self.num_actions = NUM_JOINTS
        self.device = engine.device
        self.max_episode_length = task.termination.episode_steps
        self.cfg = asdict(task)
        self.pattern = pattern.to(self.device)
        self.motors = motors.to(self.device)
        self._generator = torch.Generator(device=self.device).manual_seed(seed)

        n, zeros = self.num_envs, torch.zeros(self.num_envs, device=self.device)
        share = (torch.arange(n, device=self.device) + 0.5) / n
        span = task.frequencies.maximum - task.frequencies.minimum
        self.frequency = task.frequencies.minimum + span * share
        """Stride frequency f of each environment [Hz], shape [num_envs]; may be changed between any two steps."""
        self.target_heading = zeros.clone()
        """Yaw of the target direction in the world [rad], shape [num_envs]."""
        self.phase = zeros.clone()
        self.episode_length_buf = torch.zeros(n, dtype=torch.long, device=self.device)
        self._reflex_torque = torch.zeros(n, NUM_JOINTS, device=self.device)
        self._push = torch.zeros(n, 3, device=self.device)
        self._push_clock = self._uniform(0.0, max(task.pushes.interval, CONTROL_DT))
        # Not episode_length_buf: the runner starts that at random numbers to spread the first time-outs.
        self._episode_steps = zeros.clone()
        self._episode_rewards = {name: zeros.clone() for name in asdict(RewardWeights())}
        self._target, self._target_velocity = self.pattern.target(self.phase, self.frequency)
        self.reset(torch.ones(n, dtype=torch.bool, device=self.device))

    @torch.no_grad()
    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict]:
        """Advance every environment by 1/60 s; see :class:`rsl_rl.env.VecEnv`.

        Args:
            actions: Reflex actions, shape [num_envs, 28].

        Returns:
            Observations, rewards [num_envs], dones [num_envs] and extras. The outcome before resets is in
            :attr:`outcome`.

        Raises:
            UserError: An action is not finite: the policy has diverged.
        """
        if not torch.isfinite(actions).all():
            raise UserError("the policy gave actions that are not finite; resume from an earlier checkpoint")
        limit = self.motors.torque_limit
        self._reflex_torque = (self.task.reflex.torque_share * limit * actions).clamp(-limit, limit)
        self.engine.step(self._target, self._target_velocity, self._reflex_torque, push=self._pushes())
        self.phase = advance_phase(self.phase, self.frequency)
        self._target, self._target_velocity = self.pattern.target(self.phase, self.frequency)
        self.episode_length_buf += 1

        self.outcome = self._judge(self.engine.state)
        reward = torch.stack(list(self.outcome.reward_terms.values())).sum(dim=0)
        failed = self.outcome.fallen | self.outcome.off_course
        dones = failed | self.outcome.timed_out
        extras = {"time_outs": self.outcome.timed_out & ~failed, "log": self._log(dones)}
        self.reset(dones)
        return self.get_observations(), reward, dones.to(torch.long), extras

    def _judge(self, state: RobotState) -> StepOutcome:
        """Falls and reward terms of a state."""
        limits = self.task.termination
        finite = state.finite()
        tilted = rotations.up_axis(state.root_rotation)[:, 2] < math.cos(math.radians(limits.maximum_tilt))
        fallen = ~finite | (state.root_position[:, 2] < limits.minimum_height) | tilted
        yaw = rotations.roll_pitch_yaw(state.root_rotation)[2]
        heading_cosine = torch.cos(yaw - self.target_heading)
        off_course = ~fallen & (heading_cosine < math.cos(math.radians(limits.maximum_heading)))

        direction = torch.stack((torch.cos(self.target_heading), torch.sin(self.target_heading)), dim=1)
        error = rewards.pattern_error(self._target, state.joint_position, self.task.rewards.pattern_error)
        terms = {
            "head_height": rewards.head_height(state.head_position),
            "reflex_energy": rewards.reflex_energy(self._reflex_torque, state.joint_velocity, self.motors.torque_limit),
            "survival": rewards.survival(state.root_position),
            "upright": rewards.upright(state.root_rotation),
            "target_velocity": rewards.target_velocity(state.root_linear_velocity, direction),
            "pattern_tracking": rewards.pattern_tracking(error, self.task.rewards.pattern_error_bound),
            "sideways_speed": rewards.sideways_speed(state.root_linear_velocity, direction),
        }
        weights, scale = asdict(self.task.rewards.weights), self.task.rewards.scale
        weighted = {
            # A fall sets the step's whole reward to zero (paper, Sec. II-A.2).
            name: torch.where(fallen | off_course, 0.0, scale * weights[name] * term)
            for name, term in terms.items()
        }
        return StepOutcome(
            state=state,
            phase=self.phase,
            reflex_torque=self._reflex_torque,
            reward_terms=weighted,
            fallen=fallen,
            off_course=off_course,
            timed_out=self.episode_length_buf >= self.max_episode_length,
        )

    def _log(self, dones: torch.Tensor) -> dict[str, torch.Tensor]:
        """Episode means of the reward terms where an episode ended, and the speed of the slow and the fast third."""
        self._episode_steps += 1
        for name, term in self.outcome.reward_terms.items():
            self._episode_rewards[name] += term
        log: dict[str, torch.Tensor] = {}
        if dones.any():
            for name, total in self._episode_rewards.items():
                log[f"Episode_Reward/{name}"] = (total[dones] / self._episode_steps[dones]).mean()
                total[dones] = 0.0
            self._episode_steps[dones] = 0.0
            log["Episode_End/fallen"] = self.outcome.fallen[dones].float().mean()
            log["Episode_End/off_course"] = self.outcome.off_course[dones].float().mean()
        speed = torch.nan_to_num(self.outcome.state.root_linear_velocity[:, 0])
        third = max(1, self.num_envs // 3)
        log["Speed/lowest_third_of_f"] = speed[:third].mean()
        log["Speed/highest_third_of_f"] = speed[-third:].mean()
        return log

    def get_observations(self) -> TensorDict:
        """Current observations under the key ``policy``, shape [num_envs, 192]."""
        state = self.engine.state
        observed = observations.observe(
            state,
            target=self._target,
            cpg_torque=pd_torque(
                self._target,
                self._target_velocity,
                state.joint_position,
                state.joint_velocity,
                position_gain=self.motors.position_gain,
                velocity_gain=self.motors.velocity_gain,
            ),
            reflex_torque=self._reflex_torque,
            torque_limit=self.motors.torque_limit,
            target_heading=self.target_heading,
        )
        return TensorDict({"policy": observed}, batch_size=[self.num_envs], device=self.device)

    @torch.no_grad()
    def reset(self, mask: torch.Tensor) -> None:
        """Start new episodes: a random phase of the gait, its joint velocities, half to full forward speed.

        Args:
            mask: Environments to reset, bool, shape [num_envs].
        """
        rows = mask.nonzero().squeeze(1)
        if rows.numel() == 0:
            return
        self.phase = torch.where(mask, self._uniform(0.0, 2 * math.pi), self.phase)
        self._target, self._target_velocity = self.pattern.target(self.phase, self.frequency)
        speed_share = self._uniform(self.task.resets.minimum_speed, self.task.resets.maximum_speed)

        phase, frequency = self.phase[rows], self.frequency[rows]
        both = torch.stack((phase, advance_phase(phase, frequency)))
        pose = gait_pose(self.pattern, both, frequency.expand_as(both))
        position, rotation = pose.root_position[0], pose.root_rotation[0]
        turn = rotations.multiply(pose.root_rotation[1], rotations.conjugate(rotation))
        velocity = (pose.root_position[1] - position) / CONTROL_DT
        velocity[:, 0] += self.pattern.nominal_speed(frequency) * speed_share[rows]

        def in_all_rows(values: torch.Tensor) -> torch.Tensor:
            return values.new_zeros(self.num_envs, values.shape[1]).index_copy(0, rows, values)

        self.engine.reset(
            mask,
            root_position=in_all_rows(position),
            root_rotation=in_all_rows(rotation),
            root_linear_velocity=in_all_rows(velocity),
            root_angular_velocity=in_all_rows(2.0 * torch.sign(turn[:, 3:]) * turn[:, :3] / CONTROL_DT),
            joint_position=self._target,
            joint_velocity=self._target_velocity,
        )
        self._reflex_torque = self._reflex_torque.masked_fill(mask.unsqueeze(1), 0.0)
        self.episode_length_buf = self.episode_length_buf.masked_fill(mask, 0)

    def _pushes(self) -> torch.Tensor | None:
        """Force on the torso for this step [N], shape [num_envs, 3]; None where the task has no pushes."""
        pushes = self.task.pushes
        if pushes.force == 0.0:
            return None
        half_a_step = 0.5 * CONTROL_DT  # so that rounding decides nothing
        due = self._push_clock >= pushes.interval - half_a_step
        self._push_clock = torch.where(due, 0.0, self._push_clock)
        axes = [self._uniform(-pushes.force, pushes.force) for _ in range(3)]
        self._push = torch.where(due.unsqueeze(1), torch.stack(axes, dim=1), self._push)
        active = self._push_clock < pushes.duration - half_a_step
        self._push_clock = self._push_clock + CONTROL_DT
        return self._push * active.unsqueeze(1)

    def _uniform(self, low: float, high: float) -> torch.Tensor:
        """Random numbers in [low, high), shape [num_envs]."""
        return low + (high - low) * torch.rand(self.num_envs, generator=self._generator, device=self.device)


@dataclass
class GaitPose:
    """Poses of the imitated gait near x = 0, each tensor of shape [..., 3], [..., 4] or [..., 28]."""

    root_position: torch.Tensor
    root_rotation: torch.Tensor
    joint_position: torch.Tensor


def gait_pose(pattern: PatternNetwork, phase: torch.Tensor, frequency: torch.Tensor) -> GaitPose:
    """The whole body at a phase of the imitated gait: angles from S, the pelvis from the gait's Fourier series.

    The pelvis stands as high as in the clip, and higher where a sole would be below the ground.

    Args:
        pattern: The pattern network S.
        phase: Phase [rad], shape [...].
        frequency: Stride frequency [Hz], shape [...].
    """
    joint_position = pattern.target(phase, frequency)[0]
    motion = pattern.root_motion(phase, frequency)
    roll, pitch, yaw = motion[..., 3], motion[..., 4], motion[..., 5]
    rotation = rotations.from_roll_pitch_yaw(roll, pitch, yaw)
    position = motion[..., :3].clone()
    position[..., 2] -= sole_heights(position, rotation, joint_position).amin(dim=-1).clamp_max(0.0)
    return GaitPose(root_position=position, root_rotation=rotation, joint_position=joint_position)
