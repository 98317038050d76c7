"""What is to be learned, as data: the dataclasses that the files in ``tasks/`` fill in.

Every field can be read in the run's ``config.yaml`` and changed on the command line; its docstring is the help text.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, Self

import torch
import tyro

from aicpg_newton.engines.interface import Physics
from aicpg_newton.engines.terrain import Ground
from aicpg_newton.env.commands import Commands
from aicpg_newton.env.observations import Block
from aicpg_newton.env.rewards import RewardTerm, common_terms
from aicpg_newton.env.view import View
from aicpg_newton.errors import UserError
from aicpg_newton.robot.humanoid import CONTROL_RATE

Schedule = Literal["iteration", "minibatch", "fixed"]
"""When the learning rate is adapted to the KL divergence."""


@dataclass(kw_only=True)
class Frequencies:
    """Stride frequencies f, spread evenly over the environments; each begins every episode at its own."""

    minimum: float = 0.8
    """Lowest f [Hz] (paper, Sec. III-A)."""
    maximum: float = 1.4
    """Highest f [Hz] (paper, Sec. III-A)."""
    change_interval: float = 0.0
    """Mean time after which f goes to another value, anywhere in the range [s]; 0 keeps it as it is (the paper)."""
    change_rate: float = 0.25
    """How fast it goes there at most [Hz/s]; the rate is drawn anew for each change, between a fifth of it and all."""
    jumps: float = 0.0
    """Share of the changes that happen at once."""

    def validate(self) -> None:
        """Refuse what cannot be.

        Raises:
            UserError: A number is out of its range.
        """
        if not 0 < self.minimum <= self.maximum:
            raise UserError(
                f"frequencies run from {self.minimum} to {self.maximum} Hz; give a positive minimum no larger than the"
                " maximum"
            )
        if self.change_interval < 0.0:
            raise UserError(f"frequencies.change_interval is {self.change_interval}; give a time, or 0 for no changes")
        if not 0.0 <= self.jumps <= 1.0:
            raise UserError(f"frequencies.jumps is {self.jumps}; give a share from 0 to 1")
        fastest = (self.maximum - self.minimum) * CONTROL_RATE
        if self.change_interval > 0.0 and not 0.0 < self.change_rate < fastest:
            raise UserError(
                f"frequencies.change_rate is {self.change_rate} Hz/s; give a positive rate that does not cross the"
                f" whole range in one step ({fastest:g}), and frequencies.jumps for changes at once"
            )


@dataclass(kw_only=True)
class Reflex:
    """How the network's action becomes the reflex torque tau_r."""

    torque_share: float = 0.25
    """tau_r = share x torque limit x action, limited to the joint's limit."""


@dataclass(kw_only=True)
class Resets:
    """Start states: the CPG's pose and velocities at a random phase, feet on the ground."""

    minimum_speed: float = 0.5
    """Least forward speed, as a share of the gait's own."""
    maximum_speed: float = 1.0
    """Greatest forward speed, as a share of the gait's own."""


@dataclass(kw_only=True)
class Termination:
    """When an episode ends."""

    minimum_height: float = 0.55
    """A pelvis below this height above the ground [m] is a fall."""
    maximum_tilt: float = 60.0
    """A pelvis tilted by more than this angle from the vertical [deg] is a fall."""
    maximum_heading: float = 57.0
    """Facing away from the target by more than this angle [deg] ends the episode like a fall; 180 never does."""
    episode_steps: int = 1000
    """Control steps until the time is out."""


@dataclass(kw_only=True)
class Pushes:
    """Random pushes on the torso."""

    force: float = 0.0
    """Largest force along each world axis [N]; 0 turns pushes off."""
    duration: float = 0.1
    """Duration of a push [s]."""
    interval: float = 1.0
    """Time from push to push [s]."""

    def validate(self) -> None:
        """Refuse what cannot be.

        Raises:
            UserError: A push has no force, or goes on when the next one begins.
        """
        if self.force == 0.0 and replace(self, force=0.0) != Pushes():
            raise UserError("pushes.duration and pushes.interval change nothing where pushes.force is 0; give a force")
        if self.force != 0.0 and self.duration > self.interval:
            raise UserError(
                f"pushes.duration is {self.duration} and pushes.interval {self.interval}; a push has to end before the"
                " next one"
            )


@dataclass(kw_only=True)
class Learning:
    """Proximal policy optimisation, as rsl_rl's runner takes it."""

    network: Literal["equivariant", "mlp"] = "equivariant"
    """equivariant: layers that commute with the left-right mirror, so that the controller is exactly symmetric; mlp:
    ordinary layers."""
    hidden_sizes: tuple[int, ...] = (512, 256, 128)
    """Hidden layers of actor and critic (paper, Sec. II-A.2)."""
    critic_hidden_sizes: tuple[int, ...] = ()
    """Hidden layers of the critic where they differ from the actor's."""
    activation: Literal["relu", "elu", "selu", "lrelu", "gelu", "swish", "mish", "softplus", "tanh", "sigmoid"] = "relu"
    """Activation function (paper: ReLU); rsl_rl has these."""
    initial_std: float = 0.4
    """Standard deviation of the actions at the start."""
    learn_std: bool = True
    """Learn the standard deviation; otherwise it stays as it is at the start."""
    steps_per_iteration: int = 16
    """Control steps per environment and iteration."""
    epochs: int = 2
    """Passes over the collected samples."""
    minibatches: int = 4
    """Minibatches per pass."""
    reward_scale: float = 0.01
    """Factor on the whole reward: a return is then of the order of one, which the critic learns soonest."""
    learning_rate: float = 5e-4
    """Learning rate, or that at the start if it is adaptive."""
    learning_rate_schedule: Schedule = "iteration"
    """Adapt the learning rate to the KL divergence once an iteration, at every minibatch, or not at all."""
    minimum_learning_rate: float = 5e-5
    """Least learning rate."""
    maximum_learning_rate: float = 1e-3
    """Greatest learning rate."""
    desired_kl: float = 0.03
    """KL divergence the learning rate is adapted to: of a whole update, or of what is done of it at a minibatch."""
    discount: float = 0.99
    """Discount factor gamma."""
    gae_lambda: float = 0.95
    """Lambda of generalised advantage estimation."""
    clip: float = 0.2
    """Clipping range of the policy ratio."""
    entropy_coefficient: float = 0.0
    """Weight of the entropy bonus."""
    value_coefficient: float = 1.0
    """Weight of the value loss."""
    value_clipping: bool = False
    """Let the value of a state move by no more than ``clip`` in an iteration. Where returns are far larger, as with a
    reward scale of 0.1, most samples stop teaching the critic anything."""
    maximum_gradient_norm: float = 1.0
    """Gradient clipping."""
    symmetry: bool = True
    """Learn from every sample and its left-right mirror image, where the network is an mlp: the other has no need."""
    save_interval: int = 100
    """Iterations between checkpoints."""

    def validate(self) -> None:
        """Refuse settings that cannot be learned with.

        Raises:
            UserError: A number is out of its range.
        """
        positive = {
            "initial_std": self.initial_std,
            "steps_per_iteration": self.steps_per_iteration,
            "epochs": self.epochs,
            "minibatches": self.minibatches,
            "save_interval": self.save_interval,
            "reward_scale": self.reward_scale,
            "learning_rate": self.learning_rate,
            "minimum_learning_rate": self.minimum_learning_rate,
            "desired_kl": self.desired_kl,
            "clip": self.clip,
            "maximum_gradient_norm": self.maximum_gradient_norm,
            "hidden_sizes": min(self.hidden_sizes, default=0),
            "critic_hidden_sizes": min(self.critic_hidden_sizes, default=1),
        }
        for name, value in positive.items():
            if value <= 0:
                raise UserError(f"learning.{name} is {value}; give a positive number")
        low, high = self.minimum_learning_rate, self.maximum_learning_rate
        if not low <= self.learning_rate <= high:
            raise UserError(
                f"learning.learning_rate is {self.learning_rate}, outside of its bounds {low} to {high};"
                " change it, or learning.minimum-learning-rate and learning.maximum-learning-rate"
            )
        odd = [size for size in (*self.hidden_sizes, *self.critic_hidden_sizes) if size % 2]
        if self.network == "equivariant" and odd:
            raise UserError(
                f"layers of an equivariant network have a right and a left half, but one has {odd[0]} units; give even"
                " numbers"
            )
        for name, value in {"discount": self.discount, "gae_lambda": self.gae_lambda}.items():
            if not 0.0 <= value <= 1.0:
                raise UserError(f"learning.{name} is {value}; give a number from 0 to 1")


@dataclass(kw_only=True)
class Imitation:
    """The discriminator of the AMP baseline (Peng et al. 2021).

    Network, penalties and scale are those published for this humanoid in Isaac Gym; learning rate, batch, replay and
    weight are for 256 environments, and say what was published.
    """

    discriminator_hidden_sizes: tuple[int, ...] = (1024, 512)
    """Its hidden layers."""
    discriminator_learning_rate: float = 1e-5
    """Its learning rate. Published: 5e-5, for eight times as many samples an iteration as 256 environments give."""
    discriminator_batch: int = 256
    """Pairs of states drawn for each of its updates, as many as PPO's, from the reference, from this iteration and from
    the replay buffer, each. Published: 4096."""
    gradient_penalty: float = 5.0
    """Weight of the squared gradient at the reference."""
    logit_regularisation: float = 0.05
    """Weight of the sum of squares of its last layer's weights."""
    weight_decay: float = 1e-4
    """Weight of the sum of squares of all its weights."""
    replay_size: int = 10_000
    """Pairs in the replay buffer, which is part of every checkpoint: 6.5 MB. Published: 1,000,000."""
    replay_keep: float = 0.01
    """Share of an iteration's pairs that goes into a replay buffer that is full."""
    style_reward_scale: float = 2.0
    """The style reward lies between 0 and this."""
    style_reward_weight: float = 0.1
    """Weight of the style reward in the whole reward. Published: 1, with normalised values."""
    task_reward_weight: float = 0.0
    """Weight of the environment's own reward."""


@dataclass(kw_only=True)
class Task:
    """One task: ground, commands, rewards, resets and the learning that goes with them.

    A method makes it complete: see :mod:`aicpg_newton.env.methods`.
    """

    name: Annotated[str, tyro.conf.Suppress]
    """Name in the registry ``tasks/__init__.py``."""
    method: Annotated[str, tyro.conf.Suppress] = ""
    """Name in the registry ``aicpg_newton/env/methods.py``."""
    ground: Ground = field(default_factory=Ground)
    frequencies: Frequencies = field(default_factory=Frequencies)
    rewards: dict[str, RewardTerm] = field(default_factory=common_terms)
    """Terms of Eq. 5; each is logged as Episode_Reward/<name>."""
    observations: Annotated[tuple[Block[View], ...], tyro.conf.Suppress] = ()
    """What the network sees besides what its method shows it."""
    resets: Resets = field(default_factory=Resets)
    termination: Termination = field(default_factory=Termination)
    pushes: Pushes = field(default_factory=Pushes)
    physics: Physics = field(default_factory=Physics)
    learning: Learning = field(default_factory=Learning)

    def commands(self, num_envs: int, device: torch.device | str) -> Commands:
        """What the robots are told at first: frequencies spread evenly over the range, straight on."""
        share = (torch.arange(num_envs, device=device) + 0.5) / num_envs
        span = self.frequencies.maximum - self.frequencies.minimum
        return Commands(frequency=self.frequencies.minimum + span * share, heading=torch.zeros(num_envs, device=device))

    def undisturbed(self) -> Self:
        """The same task where nobody pushes and f stays as it is told: for tests and play."""
        return replace(self, pushes=Pushes(), frequencies=replace(self.frequencies, change_interval=0.0))

    def validate(self) -> None:
        """Refuse settings that cannot be run.

        Raises:
            UserError: A number is not finite or out of its range; the message names the setting.
        """
        for name, value in _numbers(self):
            if not math.isfinite(value):
                raise UserError(f"{name} is {value}; give a finite number")
        for name, value in self._positive().items():
            if value <= 0:
                raise UserError(f"{name} is {value}; give a positive number")
        self.physics.validate()
        self.ground.validate()
        self.learning.validate()
        self.frequencies.validate()
        self.pushes.validate()
        for name, term in self.rewards.items():
            term.validate(f"rewards.{name}")
        if not 0.0 <= self.resets.minimum_speed <= self.resets.maximum_speed:
            raise UserError(
                f"start speeds run from {self.resets.minimum_speed} to {self.resets.maximum_speed} of the gait's own;"
                " give a minimum of at least 0 and no larger than the maximum"
            )

    def _positive(self) -> dict[str, float]:
        """Settings that have to be above zero, by name."""
        return {
            "termination.episode_steps": self.termination.episode_steps,
            "pushes.duration": self.pushes.duration,
            "pushes.interval": self.pushes.interval,
        }


@dataclass(kw_only=True)
class ReflexTask(Task):
    """A task of a network that gives torques, on top of a CPG's (AI-CPG) or alone."""

    reflex: Reflex = field(default_factory=Reflex)

    def _positive(self) -> dict[str, float]:
        return {**super()._positive(), "reflex.torque_share": self.reflex.torque_share}


@dataclass(kw_only=True)
class SpeedTask(ReflexTask):
    """A task of the PPO baseline."""

    target_speed: float = 1.5
    """Speed that is to be reached [m/s]; the paper's are 1.5, 2.0, 2.5, 3.0, 3.5 and 4.0."""

    def commands(self, num_envs: int, device: torch.device | str) -> Commands:
        """See :meth:`Task.commands`; the speed as well."""
        told = super().commands(num_envs, device)
        return replace(told, speed=torch.full((num_envs,), self.target_speed, device=device))

    def _positive(self) -> dict[str, float]:
        return {**super()._positive(), "target_speed": self.target_speed}


@dataclass(kw_only=True)
class ImitationTask(Task):
    """A task of the AMP baseline."""

    reference: Literal["walk", "run"] = "walk"
    """Gait that is imitated."""
    imitation: Imitation = field(default_factory=Imitation)

    def _positive(self) -> dict[str, float]:
        return {
            **super()._positive(),
            "imitation.discriminator_hidden_sizes": min(self.imitation.discriminator_hidden_sizes, default=0),
            "imitation.discriminator_batch": self.imitation.discriminator_batch,
            "imitation.replay_size": self.imitation.replay_size,
            "imitation.discriminator_learning_rate": self.imitation.discriminator_learning_rate,
        }


def _numbers(settings: Any, prefix: str = "") -> list[tuple[str, float]]:
    """All numbers in nested dataclasses, with their dotted names."""
    found: list[tuple[str, float]] = []
    for each in dataclasses.fields(settings):
        value = getattr(settings, each.name)
        if dataclasses.is_dataclass(value):
            found += _numbers(value, f"{prefix}{each.name}.")
        elif isinstance(value, (int, float)):
            found.append((prefix + each.name, float(value)))
    return found
