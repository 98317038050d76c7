"""One control step in order: motor command, physics, phase, falls, rewards, resets, observations."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch.utils._pytree import tree_map

from aicpg_newton.device import compile_methods, plain_tensors, reading_is_free
from aicpg_newton.engines import BodyState, Engine, make_engine
from aicpg_newton.env.actuation import MotorCommand
from aicpg_newton.env.commands import Commands, FrequencyChanges
from aicpg_newton.env.faults import BadStates, FaultCount, cause_of
from aicpg_newton.env.methods import get_method
from aicpg_newton.env.observations import observe
from aicpg_newton.env.outcome import StepOutcome
from aicpg_newton.env.starts import Starts
from aicpg_newton.env.stored import to_dict
from aicpg_newton.env.style import StyleView
from aicpg_newton.env.task import Task
from aicpg_newton.env.view import View
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import PatternNetwork, advance_phase
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE, NUM_JOINTS


class Environment(VecEnv):
    """Humanoids controlled by a network, for AI-CPG on top of a pattern network; rsl_rl's ``VecEnv``.

    Args:
        task: What is to be learned.
        engine: Physics of ``num_envs`` humanoids and the ground they are on, from :func:`engine_for` the same task.
        pattern: The pattern network S.
        seed: Seed of start states, places and pushes.
        rank: Number of this process among those that train together.
        processes: Number of these. Commands are dealt to their robots in turn, so that each has the whole range.
        compiled: Let :func:`torch.compile` make a few kernels of what stands between two steps of the physics. It takes
            a minute at the start and a compiler on the machine; on a GPU launching hundreds of kernels takes longer
            than the physics.
    """

    def __init__(
        self,
        task: Task,
        engine: Engine,
        pattern: PatternNetwork,
        *,
        seed: int = 0,
        rank: int = 0,
        processes: int = 1,
        compiled: bool = False,
    ) -> None:
        task.validate()
        self.task = task = task.for_environments(engine.num_envs)
        self.engine = engine
        self.num_envs = engine.num_envs
        self.num_actions = NUM_JOINTS
        self.device = engine.device
        self.max_episode_length = task.termination.episode_steps
        self.cfg = to_dict(task)
        self.pattern = pattern.to(self.device)
        method = get_method(task.method)
        self.motors = task.motors().to(self.device)
        self._generator = torch.Generator(device=self.device).manual_seed(seed)

        n, zeros = self.num_envs, torch.zeros(self.num_envs, device=self.device)
        self.commands = task.commands(n * processes, self.device).every(processes, rank)
        """What the robots are told; :meth:`command` changes it."""
        self._commands_to_come: Commands | None = None
        self._seen: View | None = None
        changes = task.frequencies
        self._changes = None
        if changes.change_interval > 0.0:
            self._changes = FrequencyChanges(
                changes.minimum,
                changes.maximum,
                interval=changes.change_interval,
                rate=changes.change_rate,
                jumps=changes.jumps,
                generator=self._generator,
            )
        self.phase = zeros.clone()
        self.level = torch.zeros(n, dtype=torch.long, device=self.device)
        """Level of the terrain that each robot starts its next episode on, shape [num_envs]."""
        self.episode_length_buf = torch.zeros(n, dtype=torch.long, device=self.device)
        self.actuation = method.actuation(task, self.pattern, self.motors, n, self._generator)
        """What turns actions into motor commands."""
        self.blocks = (*method.actuation.blocks, *task.observations)
        """What the network sees, in order."""
        self._flat = zeros
        scale = task.learning.reward_scale
        self._terms = {name: (scale * term.weight, term) for name, term in task.rewards.items() if term.weight}
        self._push = torch.zeros(n, 3, device=self.device)
        self._push_clock = self._uniform(0.0, max(task.pushes.interval, CONTROL_DT))
        self._asked_pushes: list[torch.Tensor] = []
        self._starts = Starts(task.resets, self.actuation, engine.terrain, self._generator)
        self._sound = torch.ones(n, dtype=torch.bool, device=self.device)
        self.faults = FaultCount(n, self.device)
        """Simulations that went wrong."""
        self.bad_states: BadStates | None = None
        """Keeps what they began from, where one is put here; every step is then copied before it is taken."""
        self._logged = (
            *(f"Episode_Reward/{name}" for name in self._terms),
            *(f"Episode_End/{name}" for name in ("fallen", "diverged", "off_course")),
        )
        self._episode_means = torch.zeros(len(self._logged), device=self.device)
        # Not episode_length_buf: the runner starts that at random numbers to spread the first time-outs.
        self._episode_steps = zeros.clone()
        self._episode_rewards = torch.zeros(len(self._terms), n, device=self.device)
        self._compiled = compiled
        if compiled:
            if self.actuation.style_blocks:
                self._observe_style()  # makes the constants of its kinematics, which then are some to the compiler too
                compile_methods(self, ("_observe_style",), self.device, repeated=4)  # a chain of many rotations
            engine.compile()
            compile_methods(self, _COMPILED, self.device)
        try:
            self.restart(self.commands.frequency)
        except Exception as error:  # a compiler that is not there, or does not work, raises many types
            if not compiled or isinstance(error, UserError):
                raise
            reason = (str(error) or type(error).__name__).strip().splitlines()[0]
            raise UserError(f"torch.compile does not work here ({reason}); give --compile off") from error

    @plain_tensors
    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict]:
        """Advance every environment by 1/60 s; see :class:`rsl_rl.env.VecEnv`.

        Args:
            actions: Actions of the network, shape [num_envs, 28].

        Returns:
            Observations, rewards [num_envs], dones [num_envs] and extras. The outcome before resets is in
            :attr:`outcome`.

        Raises:
            UserError: On a CPU, as :meth:`check`.
        """
        if actions.is_inference():
            actions = actions.clone()  # of the kind of all others
        command = self._ask(actions)
        if reading_is_free(self.device):
            self.check()
        push = self._pushes()
        before = None if self.bad_states is None else self.engine.snapshot()
        self.engine.step(*command, push=push)
        changes = None if self._changes is None else self._changes.draw(self.num_envs)
        levels = self._uniform(0.0, self.task.ground.levels) if self.task.ground.levels > 1 else None
        reward, dones, log = self._settle(changes, levels)
        if self.bad_states is not None and before is not None:
            given = {"action": actions, **command._asdict(), **({} if push is None else {"push": push})}
            self.bad_states.note(self.outcome.fault, {**before, **given})
        extras = {"time_outs": self.outcome.timed_out, "log": log}
        self._start_anew(dones)
        self._follow()
        self._starts.grow_old(self.commands.frequency if self._changes is None else self._own_frequency)
        return self.get_observations(), reward, dones.to(torch.long), extras

    def _ask(self, actions: torch.Tensor) -> MotorCommand:
        """What the engine is told; whether all actions were numbers is kept."""
        self._sound = self._sound & (actions.abs().amax(dim=1) < math.inf)  # which NaN is not, either
        return self.actuation.command(actions, self.engine.state)

    def _settle(
        self, changes: torch.Tensor | None, levels: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
        """All that follows from a step of the physics, before any robot begins anew.

        Args:
            changes: From :meth:`FrequencyChanges.draw`, where frequencies change.
            levels: Levels for robots that have done with all, where there are several, shape [num_envs].

        Returns:
            Rewards and whether the episode ended, each of shape [num_envs], and the log.
        """
        self.phase = advance_phase(self.phase, self.commands.frequency)
        self.actuation.go_on()
        self.episode_length_buf = self.episode_length_buf + 1
        self._seen = None
        self.outcome = self._judge()
        self.faults.note(self.outcome.fault)
        rewards = torch.stack(list(self.outcome.reward_terms.values()))
        failed = self.outcome.fallen | self.outcome.off_course
        dones = failed | self.outcome.timed_out
        if self._changes is not None:
            assert changes is not None
            now = torch.where(dones, self._own_frequency, self.commands.frequency)
            self.command(frequency=self._changes.next(now, dones, changes))
        self._obey()
        self._episode_steps = self._episode_steps + 1
        if levels is not None:
            self._move_between_levels(failed, self.outcome.timed_out, levels.long())
        self._episode_rewards = self._episode_rewards + rewards
        log = self._log(dones)
        self._drop_what_kernels_saw()
        return rewards.sum(dim=0), dones, log

    def check(self) -> None:
        """Look whether all actions so far were numbers. On a GPU this waits for it: once an iteration is enough.

        Raises:
            UserError: An action was not finite: the policy has diverged.
        """
        if not bool(self._sound.all()):
            raise UserError("the policy gave actions that are not finite; resume from an earlier checkpoint")

    def command(self, *, frequency: torch.Tensor | None = None, heading: torch.Tensor | None = None) -> None:
        """Tell the robots something else, from the end of the coming control step on.

        The step that is about to begin has been planned: its observations have been seen. When it is over, phase,
        target and observations change to the new commands at once.

        Args:
            frequency: Stride frequency f [Hz], shape [num_envs]; None leaves it as it is.
            heading: Yaw of the target direction in the world [rad], shape [num_envs]; None leaves it as it is.
        """
        told = self.commands if self._commands_to_come is None else self._commands_to_come
        given = {"frequency": frequency, "heading": heading}
        self._commands_to_come = replace(told, **{name: value for name, value in given.items() if value is not None})

    def push(self, force: torch.Tensor) -> None:
        """Push the torsos for as long as one of the task's pushes lasts, from the coming control step on.

        Args:
            force: Force on the torso's centre of mass, world frame [N], shape [num_envs, 3].
        """
        self._asked_pushes = [force] * max(1, round(self.task.pushes.duration * CONTROL_RATE))

    def _obey(self) -> None:
        """Take over what :meth:`command` was given since the last step."""
        if self._commands_to_come is not None:
            self.commands, self._commands_to_come = self._commands_to_come, None
            self._seen = None

    def _follow(self) -> None:
        """Targets of the coming step, once it is known what the robots are told and who begins anew."""
        self.actuation.follow(self.phase, self.commands)
        if self._seen is not None:
            self._seen.target, self._seen.target_velocity = self.actuation.target, self.actuation.target_velocity

    def _view(self) -> View:
        """The robots as they are now; made anew only after they, their commands or their targets have changed."""
        if self._seen is not None:
            return self._seen
        state, terrain, actuation = self.engine.state, self.engine.terrain, self.actuation
        self._seen = View(
            state=state,
            ground_height=self._flat if terrain is None else terrain.height(state.root_position),
            commands=self.commands,
            terrain=terrain,
            motors=self.motors,
            torque=actuation.torque,
            torque_unit=actuation.torque_unit,
            target=actuation.target,
            target_velocity=actuation.target_velocity,
        )
        return self._seen

    def _judge(self) -> StepOutcome:
        """Falls and reward terms of the robots as they are now."""
        limits, view = self.task.termination, self._view()
        state = view.state
        fault = cause_of(state, view.height, self.engine.overflowed)
        fallen = (fault > 0) | (view.height < limits.minimum_height)
        fallen |= view.up < math.cos(math.radians(limits.maximum_tilt))
        heading_cosine = torch.cos(view.roll_pitch_yaw[2] - self.commands.heading)
        off_course = ~fallen & (heading_cosine < math.cos(math.radians(limits.maximum_heading)))
        failed = fallen | off_course
        timed_out = self.episode_length_buf >= self.max_episode_length
        if self.engine.terrain is not None:
            timed_out = timed_out | ~self.engine.terrain.inside(state.root_position)
        return StepOutcome(
            state=state,
            phase=self.phase,
            commands=self.commands,
            torque=view.torque,
            ground_height=view.ground_height,
            # A fall sets the step's whole reward to zero (paper, Sec. II-A.2).
            reward_terms={
                name: (weight * term(view)).masked_fill(failed, 0.0) for name, (weight, term) in self._terms.items()
            },
            fallen=fallen,
            fault=fault,
            off_course=off_course,
            timed_out=timed_out & ~failed,
        )

    def _seen_to_be_none(self, mask: torch.Tensor) -> bool:
        """Whether a look that costs no waiting shows that no environment is in the mask: its work can be left out."""
        return reading_is_free(self.device) and not bool(mask.any())

    def _move_between_levels(self, failed: torch.Tensor, lasted: torch.Tensor, anywhere: torch.Tensor) -> None:
        """Curriculum: robots that lasted half an episode or more go on to rougher ground, robots that failed go back.

        Those that lasted on the roughest begin anywhere, so that none is forgotten. A robot may come to the edge early,
        and the runner begins with episodes that are nearly over.
        """
        long = self._episode_steps >= 0.5 * self.max_episode_length
        level = self.level + (lasted & long).long() - failed.long()
        self.level = torch.where(level < self.task.ground.levels, level.clamp_min(0), anywhere)

    def _log(self, dones: torch.Tensor) -> dict[str, torch.Tensor]:
        """Episode means of the reward terms where an episode ended, and the speed at slow and at fast frequencies."""
        if self._compiled or not self._seen_to_be_none(dones):
            self._note_ended(dones)
        log = dict(zip(self._logged, self._episode_means.unbind(0), strict=True))
        speed = self.outcome.state.root_linear_velocity[:, 0].masked_fill(self.outcome.diverged, 0.0)
        if self.task.ground.levels > 1:
            log["Curriculum/level"] = self.level.float().mean()
        told, frequency = self.task.frequencies, self.outcome.commands.frequency
        third = (told.maximum - told.minimum) / 3.0
        thirds = torch.stack((frequency <= told.minimum + third, frequency >= told.maximum - third))
        lowest, highest = torch.where(thirds, speed, 0.0).sum(dim=1) / thirds.sum(dim=1).clamp_min(1)
        return log | {"Speed/lowest_third_of_f": lowest, "Speed/highest_third_of_f": highest}

    def _note_ended(self, dones: torch.Tensor) -> None:
        """Means over the episodes that have just ended; where there are none, the last ones stay."""
        outcome = self.outcome
        ends = torch.stack((outcome.fallen, outcome.diverged, outcome.off_course, dones)).float()
        ended = torch.cat((self._episode_rewards / self._episode_steps, ends))
        sums = ended.masked_fill(~dones, 0.0).sum(dim=1)
        number = sums[-1]
        means = sums[:-1] / number.clamp_min(1.0)
        self._episode_means = torch.where(number > 0, means, self._episode_means)
        self._episode_rewards = self._episode_rewards.masked_fill(dones, 0.0)
        self._episode_steps = self._episode_steps.masked_fill(dones, 0.0)

    @plain_tensors
    def get_observations(self) -> TensorDict:
        """Current observations: under ``policy`` the network's, shape [num_envs, 192] (136 without a CPG).

        Where a discriminator judges the style, also under ``style``, shape [num_envs, 81].
        """
        seen = {"policy": self._observe()}
        if self.actuation.style_blocks:
            seen["style"] = self._observe_style()
        return TensorDict(seen, batch_size=[self.num_envs], device=self.device)

    def _observe(self) -> torch.Tensor:
        """What the network sees, shape [num_envs, size]."""
        seen = observe(self.blocks, self._view())
        self._drop_what_kernels_saw()
        return seen

    def _observe_style(self) -> torch.Tensor:
        """What a discriminator sees, shape [num_envs, 81]."""
        view = self._view()
        seen = observe(self.actuation.style_blocks, StyleView(view.state, view.ground_height))
        self._drop_what_kernels_saw()
        return seen

    def _drop_what_kernels_saw(self) -> None:
        """What a view has derived within compiled kernels stays there."""
        if self._compiled:
            self._seen = None

    @plain_tensors
    def restart(self, frequency: torch.Tensor) -> None:
        """Start new episodes in all environments, at these stride frequencies [Hz], shape [num_envs]."""
        self.commands, self._commands_to_come = replace(self.commands, frequency=frequency), None
        self._own_frequency = frequency.clone()  # two tensors: torch compiles anew where one is no longer the other
        """Stride frequency that each robot begins an episode with [Hz], shape [num_envs]."""
        if self._changes is not None:
            self._changes.begin(frequency)
        self._starts.draw(frequency)
        self.reset(torch.ones(self.num_envs, dtype=torch.bool, device=self.device))

    @plain_tensors
    def reset(self, mask: torch.Tensor) -> None:
        """Start new episodes, as :class:`Starts` has them ready.

        Args:
            mask: Environments to reset, bool, shape [num_envs].
        """
        self._start_anew(mask)
        self._follow()

    def _start_anew(self, mask: torch.Tensor) -> None:
        """:meth:`reset`, but for the targets."""
        if self._seen_to_be_none(mask):
            return
        self.engine.reset(mask, self._begin(mask))
        self._seen = None

    def _begin(self, mask: torch.Tensor) -> BodyState:
        """Phase and memory of the masked environments' new episodes; where all robots would start."""
        self.phase = torch.where(mask, self._starts.phase, self.phase)
        self.actuation.forget(mask)
        self.episode_length_buf = self.episode_length_buf.masked_fill(mask, 0)
        return self._starts.states(self.level)

    def state_dict(self) -> dict[str, Any]:
        """Copies of all that coming steps depend on, between two steps: robots, commands, random numbers, means."""
        own = {name: getattr(self, name) for name in _STATE}
        state = {
            **own,
            "engine": self.engine.snapshot(),
            "commands": vars(self.commands),
            "torque": self.actuation.torque,
            "starts": self._starts.state_dict(),
            "changes": None if self._changes is None else self._changes.state_dict(),
            "generator": self._generator.get_state(),
        }
        return tree_map(lambda each: each.clone() if isinstance(each, torch.Tensor) else each, state)

    @plain_tensors
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a :meth:`state_dict` of an environment with the same task, engine and number of robots."""
        self._generator.set_state(state["generator"].cpu())
        state = tree_map(lambda each: each.to(self.device) if isinstance(each, torch.Tensor) else each, state)
        self.engine.restore(state["engine"])
        for name in _STATE:
            setattr(self, name, state[name])
        self.commands, self._commands_to_come = Commands(**state["commands"]), None
        self._starts.load_state_dict(state["starts"])
        if self._changes is not None:
            self._changes.load_state_dict(state["changes"])
        self.actuation.torque = state["torque"]
        self._seen = None
        self._follow()

    def _pushes(self) -> torch.Tensor | None:
        """Force on the torso for this step [N], shape [num_envs, 3]; None where nobody pushes."""
        own = None
        if self.task.pushes.force > 0.0:
            own = self._push_on(torch.rand(self.num_envs, 3, generator=self._generator, device=self.device))
        if not self._asked_pushes:
            return own
        asked = self._asked_pushes.pop()
        return asked if own is None else own + asked

    def _push_on(self, drawn: torch.Tensor) -> torch.Tensor:
        """The task's own pushes, given random numbers in [0, 1) for those that begin, shape [num_envs, 3]."""
        pushes = self.task.pushes
        half_a_step = 0.5 * CONTROL_DT  # so that rounding decides nothing
        due = self._push_clock >= pushes.interval - half_a_step
        self._push_clock = torch.where(due, 0.0, self._push_clock)
        self._push = torch.where(due.unsqueeze(1), pushes.force * (2.0 * drawn - 1.0), self._push)
        active = self._push_clock < pushes.duration - half_a_step
        self._push_clock = self._push_clock + CONTROL_DT
        share = self.level / (self.task.ground.levels - 1) if pushes.grow_with_level else 1.0
        return self._push * (active * share).unsqueeze(1)

    def _uniform(self, low: float, high: float) -> torch.Tensor:
        """Random numbers in [low, high), shape [num_envs]."""
        return low + (high - low) * torch.rand(self.num_envs, generator=self._generator, device=self.device)


_COMPILED = ("_ask", "_push_on", "_settle", "_begin", "_follow", "_observe")
"""What stands between two steps of the physics."""

_STATE = (
    "phase",
    "level",
    "episode_length_buf",
    "_own_frequency",
    "_push",
    "_push_clock",
    "_sound",
    "_episode_means",
    "_episode_steps",
    "_episode_rewards",
)
"""What an environment itself keeps from step to step."""


def engine_for(task: Task, name: str, num_envs: int, device: torch.device | str) -> Engine:
    """The engine with a task's physics, ground and motors.

    Args:
        task: What is to be learned.
        name: ``newton``, ``mujoco`` or ``auto``.
        num_envs: Number of humanoids.
        device: Torch device, ``cuda:0`` or ``cpu``.

    Raises:
        UserError: As :func:`make_engine`, or a setting is out of its range.
    """
    task.validate()
    return make_engine(name, num_envs, device, task.motors(), task.physics, task.ground)
