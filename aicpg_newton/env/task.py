"""What is to be learned, as data: the dataclasses that the files in ``tasks/`` fill in.

Every field can be read in the run's ``config.yaml`` and changed on the command line; its docstring is the help text.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Annotated, Literal, Self

import torch
import tyro

from aicpg_newton.engines.interface import Physics
from aicpg_newton.engines.terrain import Ground
from aicpg_newton.env.commands import Commands
from aicpg_newton.env.observations import Block
from aicpg_newton.env.rewards import RewardTerm, common_terms
from aicpg_newton.env.view import View
from aicpg_newton.errors import UserError
from aicpg_newton.ranges import AT_LEAST_ONE, NOT_NEGATIVE, POSITIVE, SHARE, Range, check_ranges
from aicpg_newton.robot import humanoid
from aicpg_newton.robot.humanoid import CONTROL_RATE

MAXIMUM_LAYERS = 16
"""Hidden layers that a network may have."""

LAYER = Range(1, 8192)
"""Units that a hidden layer may have: larger ones come from broken or hostile files, and fill the memory."""

TEST_SUBSTEPS = 4
"""Fewest physics steps per control step in tests and play: 240 Hz. Training takes half, as the paper's simulator."""

TEST_HEADING = 57.0
"""In tests and play a robot that faces away from the target by more than this angle [deg] has turned away."""

Schedule = Literal["iteration", "minibatch", "fixed"]
"""When the learning rate is adapted to the KL divergence."""


@dataclass(kw_only=True)
class Frequencies:
    """Stride frequencies f, spread evenly over the environments; each begins every episode at its own."""

    minimum: Annotated[float, Range(0.0, 10.0, positive=True)] = 0.8
    """Lowest f [Hz] (paper, Sec. III-A)."""
    maximum: Annotated[float, Range(0.0, 10.0, positive=True)] = 1.4
    """Highest f [Hz] (paper, Sec. III-A)."""
    change_interval: Annotated[float, NOT_NEGATIVE] = 0.0
    """Mean time after which f goes to another value, anywhere in the range [s]; 0 keeps it as it is (the paper)."""
    change_rate: Annotated[float, POSITIVE] = 0.25
    """How fast it goes there at most [Hz/s]; the rate is drawn anew for each change, between a fifth of it and all."""
    jumps: Annotated[float, SHARE] = 0.0
    """Share of the changes that happen at once."""

    def validate(self) -> None:
        """Refuse what cannot be.

        Raises:
            UserError: A number is out of its range.
        """
        if self.minimum > self.maximum:
            raise UserError(
                f"frequencies run from {self.minimum} to {self.maximum} Hz; give a minimum no larger than the maximum"
            )
        fastest = (self.maximum - self.minimum) * CONTROL_RATE
        if self.change_interval > 0.0 and self.change_rate >= fastest:
            raise UserError(
                f"frequencies.change_rate is {self.change_rate} Hz/s; give a rate that does not cross the"
                f" whole range in one step ({fastest:g}), and frequencies.jumps for changes at once"
            )


@dataclass(kw_only=True)
class Reflex:
    """How the network's action becomes the reflex torque tau_r."""

    unit: Literal["gear", "limit"] = "gear"
    """Unit of torque of each joint, which bounds tau_r and in which R_e (Eq. 6) charges for it: the gear of the motor
    table (Isaac Gym's humanoid, as in the paper), or the joint's torque limit."""
    torque_share: Annotated[float, POSITIVE] = 0.4
    """tau_r = share x unit x action, clipped to +-unit."""


@dataclass(kw_only=True)
class Resets:
    """Start states: the CPG's pose and velocities at a random phase, feet on the ground."""

    minimum_speed: Annotated[float, NOT_NEGATIVE] = 0.5
    """Least forward speed, as a share of the gait's own."""
    maximum_speed: Annotated[float, NOT_NEGATIVE] = 1.0
    """Greatest forward speed, as a share of the gait's own."""


@dataclass(kw_only=True)
class Termination:
    """When an episode ends."""

    minimum_height: Annotated[float, Range(0.0, 2.0)] = 0.55
    """A pelvis below this height above the ground [m] is a fall."""
    maximum_tilt: Annotated[float, Range(0.0, 180.0, positive=True)] = 60.0
    """A pelvis tilted by more than this angle from the vertical [deg] is a fall."""
    maximum_heading: Annotated[float, Range(0.0, 180.0, positive=True)] = 180.0
    """Facing away from the target by more than this angle [deg] ends the episode like a fall; 180 never does (the
    paper). In tests and play it is at most 57."""
    episode_steps: Annotated[int, AT_LEAST_ONE] = 1000
    """Control steps until the time is out."""


@dataclass(kw_only=True)
class Pushes:
    """Random pushes on the torso."""

    force: Annotated[float, NOT_NEGATIVE] = 0.0
    """Largest force along each world axis [N]; 0 turns pushes off."""
    duration: Annotated[float, POSITIVE] = 0.1
    """Duration of a push [s]."""
    interval: Annotated[float, POSITIVE] = 1.0
    """Time from push to push [s]."""
    grow_with_level: bool = False
    """Scale the force with the robot's level of the terrain: none on the first, all on the last (``ground.levels``)."""

    def validate(self) -> None:
        """Refuse what cannot be.

        Raises:
            UserError: A push goes on when the next one begins.
        """
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
    hidden_sizes: Annotated[tuple[int, ...], LAYER] = (512, 256, 128)
    """Hidden layers of actor and critic (paper, Sec. II-A.2)."""
    critic_hidden_sizes: Annotated[tuple[int, ...], LAYER] = ()
    """Hidden layers of the critic where they differ from the actor's."""
    activation: Literal["relu", "elu", "selu", "lrelu", "gelu", "swish", "mish", "softplus", "tanh", "sigmoid"] = "relu"
    """Activation function (paper: ReLU); rsl_rl has these."""
    initial_std: Annotated[float, POSITIVE] = 0.4
    """Standard deviation of the actions at the start."""
    learn_std: bool = True
    """Learn the standard deviation; otherwise it stays as it is at the start."""
    steps_per_iteration: Annotated[int, AT_LEAST_ONE] = 16
    """Control steps per environment and iteration."""
    epochs: Annotated[int, AT_LEAST_ONE] = 2
    """Passes over the collected samples."""
    minibatches: Annotated[int, AT_LEAST_ONE] = 4
    """Minibatches per pass."""
    reward_scale: Annotated[float, POSITIVE] = 0.01
    """Factor on the whole reward: a return is then of the order of one, which the critic learns soonest."""
    learning_rate: Annotated[float, POSITIVE] = 5e-4
    """Learning rate, or that at the start if it is adaptive."""
    learning_rate_schedule: Schedule = "iteration"
    """Adapt the learning rate to the KL divergence once an iteration, at every minibatch, or not at all."""
    minimum_learning_rate: Annotated[float, POSITIVE] = 5e-5
    """Least learning rate."""
    maximum_learning_rate: Annotated[float, POSITIVE] = 1e-3
    """Greatest learning rate."""
    desired_kl: Annotated[float, POSITIVE] = 0.03
    """KL divergence the learning rate is adapted to at first: of a whole update, or of what is done of it at a
    minibatch."""
    final_kl: Annotated[float, POSITIVE] = 0.01
    """The same from iteration ``kl_decay`` on. Exploration shrinks as energy is saved; steps that were right for a loud
    policy then make robots at the edge of their range fall again (docs/reward.md)."""
    kl_decay: Annotated[int, AT_LEAST_ONE] = 1000
    """Iterations over which the desired divergence goes from the one to the other, on a straight line."""
    discount: Annotated[float, SHARE] = 0.99
    """Discount factor gamma."""
    gae_lambda: Annotated[float, SHARE] = 0.95
    """Lambda of generalised advantage estimation."""
    clip: Annotated[float, POSITIVE] = 0.2
    """Clipping range of the policy ratio."""
    entropy_coefficient: Annotated[float, NOT_NEGATIVE] = 0.0
    """Weight of the entropy bonus."""
    value_coefficient: Annotated[float, NOT_NEGATIVE] = 1.0
    """Weight of the value loss."""
    value_clipping: bool = False
    """Let the value of a state move by no more than ``clip`` in an iteration. Where returns are far larger, as with a
    reward scale of 0.1, most samples stop teaching the critic anything."""
    maximum_gradient_norm: Annotated[float, POSITIVE] = 1.0
    """Gradient clipping."""
    symmetry: bool = True
    """Learn from every sample and its left-right mirror image, where the network is an mlp: the other has no need."""
    save_interval: Annotated[int, AT_LEAST_ONE] = 100
    """Iterations between checkpoints."""

    def validate(self) -> None:
        """Refuse settings that cannot be learned with.

        Raises:
            UserError: A number is out of its range.
        """
        _check_layers("learning.hidden_sizes", self.hidden_sizes)
        _check_layers("learning.critic_hidden_sizes", self.critic_hidden_sizes or self.hidden_sizes)
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


@dataclass(kw_only=True)
class Imitation:
    """The discriminator of the AMP baseline (Peng et al. 2021).

    Network, loss, penalties and scale are those published for this humanoid in Isaac Gym, for 4096 environments.
    Learning rate, batch and replay were tried with 256, and grow with the number of environments where they are not
    given: see :meth:`for_environments`.
    """

    loss: Literal["cross_entropy", "least_squares"] = "cross_entropy"
    """What it learns, and with that the reward: logarithms as in Isaac Gym, or squares as in Peng et al. (Eq. 6-7)."""
    discriminator_hidden_sizes: Annotated[tuple[int, ...], LAYER] = (1024, 512)
    """Its hidden layers."""
    discriminator_learning_rate: Annotated[float | None, POSITIVE] = None
    """Its learning rate; 3e-5 with 256 environments up to the published 5e-5 with 712 and more when not given."""
    discriminator_batch: Annotated[int | None, AT_LEAST_ONE] = None
    """Pairs of states drawn for each of its updates, as many as PPO's, from the reference, from this iteration and from
    the replay buffer, each; as many as environments, from 256 to 4096, when not given. Published: 4096."""
    gradient_penalty: Annotated[float, NOT_NEGATIVE] = 5.0
    """Weight of the squared gradient at the reference."""
    logit_regularisation: Annotated[float, NOT_NEGATIVE] = 0.05
    """Weight of the sum of squares of its last layer's weights."""
    weight_decay: Annotated[float, NOT_NEGATIVE] = 1e-4
    """Weight of the sum of squares of all its weights."""
    replay_size: Annotated[int | None, Range(1, 100_000_000)] = None
    """Pairs in the replay buffer, 0.65 kB each, which is part of every checkpoint; 10,000 with 256 environments up to
    160,000 with 4096 when not given. Published: 1,000,000."""
    replay_keep: Annotated[float, SHARE] = 0.01
    """Share of an iteration's pairs that goes into a replay buffer that is full."""
    style_reward_scale: Annotated[float, NOT_NEGATIVE] = 2.0
    """Factor of the style reward. With cross-entropy it is 1.39 where the discriminator cannot tell, and 18.4 at most;
    with least squares this is the most."""
    style_reward_weight: Annotated[float, NOT_NEGATIVE] = 0.1
    """Weight of the style reward in the whole reward. Published: 1, with normalised values."""
    task_reward_weight: Annotated[float, NOT_NEGATIVE] = 0.0
    """Weight of the environment's own reward."""

    def for_environments(self, number: int) -> Imitation:
        """What is left open, for so many environments: the one place where the rule stands.

        Batch and replay buffer are proportional to the number of environments, and the learning rate, up to the
        published one, to its square root, as the noise of a gradient falls with it. Below 256, what these numbers were
        tried with, and above 4096, where the batch is the published one, nothing changes any more.
        """
        times = min(max(number / 256, 1.0), 16.0)
        rule = {
            "discriminator_learning_rate": min(3e-5 * math.sqrt(times), 5e-5),
            "discriminator_batch": round(256 * times),
            "replay_size": round(10_000 * times),
        }
        return replace(self, **{name: value for name, value in rule.items() if getattr(self, name) is None})


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
    physics: Physics = field(default_factory=lambda: Physics(substeps=2))
    learning: Learning = field(default_factory=Learning)

    def commands(self, num_envs: int, device: torch.device | str) -> Commands:
        """What the robots are told at first: frequencies spread evenly over the range, straight on."""
        share = (torch.arange(num_envs, device=device) + 0.5) / num_envs
        span = self.frequencies.maximum - self.frequencies.minimum
        return Commands(frequency=self.frequencies.minimum + span * share, heading=torch.zeros(num_envs, device=device))

    def for_environments(self, number: int) -> Self:
        """The same task, with the settings that are left open chosen for so many environments."""
        return self

    def motors(self) -> humanoid.Motors:
        """Gains, limits, damping and armature of the joints."""
        return humanoid.motors()

    def undisturbed(self) -> Self:
        """The same task for tests and play: no pushes, constant f, physics at 240 Hz or more, turning away noticed."""
        return replace(
            self,
            pushes=Pushes(),
            frequencies=replace(self.frequencies, change_interval=0.0),
            physics=replace(self.physics, substeps=max(self.physics.substeps, TEST_SUBSTEPS)),
            termination=replace(self.termination, maximum_heading=min(self.termination.maximum_heading, TEST_HEADING)),
        )

    def validate(self) -> None:
        """Refuse settings that cannot be run.

        Raises:
            UserError: A number is not finite or out of its range; the message names the setting.
        """
        check_ranges(self)
        self.physics.validate()
        self.ground.validate()
        self.learning.validate()
        self.frequencies.validate()
        self.pushes.validate()
        if self.pushes.grow_with_level and self.ground.levels < 2:
            raise UserError("pushes.grow_with_level needs levels; give ground.levels of at least 2, or turn it off")
        for name, term in self.rewards.items():
            term.validate(f"rewards.{name}")
        if self.resets.minimum_speed > self.resets.maximum_speed:
            raise UserError(
                f"start speeds run from {self.resets.minimum_speed} to {self.resets.maximum_speed} of the gait's own;"
                " give a minimum no larger than the maximum"
            )

    def idle(self) -> dict[str, str]:
        """Settings that do nothing beside the others, by dotted name, and why: to change one is a misunderstanding."""
        found: dict[str, str] = {}

        def unless(used: bool, why: str, *names: str) -> None:
            if not used:
                found.update(dict.fromkeys(names, why))

        plane = [f"ground.{name}" for name in ("shape", "cell", "feature", "length", "width", "seed")]
        unless(self.ground.uneven, "the ground is a plane, as ground.height_range is 0", *plane)
        changes = ("frequencies.change_rate", "frequencies.jumps")
        unless(self.frequencies.change_interval > 0, "f stays, as frequencies.change_interval is 0", *changes)
        pushes = [f"pushes.{name}" for name in ("duration", "interval", "grow_with_level")]
        unless(self.pushes.force > 0, "there are no pushes, as pushes.force is 0", *pushes)
        learning = self.learning
        mirrored = "an equivariant network is symmetric by itself"
        unless(learning.network == "mlp", mirrored, "learning.symmetry")
        fixed = "the learning rate stays, as learning.learning_rate_schedule is fixed"
        divergences = ("learning.desired_kl", "learning.final_kl", "learning.kl_decay")
        unless(learning.learning_rate_schedule != "fixed", fixed, *divergences)
        return found

    def refuse_idle_changes(self, default: Task) -> None:
        """Refuse that a setting was changed that does nothing.

        Args:
            default: The task before its settings were changed.

        Raises:
            UserError: One was; the message names it and says why it does nothing.
        """
        for name, why in self.idle().items():
            read = attrgetter(name)
            if read(self) != read(default):
                raise UserError(f"{name} was changed, but does nothing: {why}; leave it as it is")


@dataclass(kw_only=True)
class ReflexTask(Task):
    """A task of a network that gives torques, on top of a CPG's (AI-CPG) or alone."""

    reflex: Reflex = field(default_factory=Reflex)


@dataclass(kw_only=True)
class SpeedTask(ReflexTask):
    """A task of the PPO baseline."""

    target_speed: Annotated[float, Range(0.0, 20.0, positive=True)] = 1.5
    """Speed that is to be reached [m/s]; the paper's are 1.5, 2.0, 2.5, 3.0, 3.5 and 4.0."""

    def commands(self, num_envs: int, device: torch.device | str) -> Commands:
        """See :meth:`Task.commands`; the speed as well."""
        told = super().commands(num_envs, device)
        return replace(told, speed=torch.full((num_envs,), self.target_speed, device=device))

    def motors(self) -> humanoid.Motors:
        """See :meth:`Task.motors`: as sources of torque."""
        return humanoid.torque_motors()

    def idle(self) -> dict[str, str]:
        """See :meth:`Task.idle`: a speed is told, and robots start standing."""
        return {
            **super().idle(),
            "frequencies": "target_speed sets the gait of this method, not f",
            "resets": "robots of this method start standing",
        }


@dataclass(kw_only=True)
class ImitationTask(Task):
    """A task of the AMP baseline."""

    reference: Literal["walk", "run"] = "walk"
    """Gait that is imitated."""
    drives: Literal["damped", "pattern"] = "damped"
    """Gains of the PD law that follows the network's targets: well damped, as published with AMP, or a CPG's."""
    imitation: Imitation = field(default_factory=Imitation)

    def for_environments(self, number: int) -> Self:
        """See :meth:`Task.for_environments` and :meth:`Imitation.for_environments`."""
        return replace(self, imitation=self.imitation.for_environments(number))

    def motors(self) -> humanoid.Motors:
        """See :meth:`Task.motors` and :attr:`drives`."""
        return humanoid.target_motors() if self.drives == "damped" else humanoid.motors()

    def idle(self) -> dict[str, str]:
        """See :meth:`Task.idle`: the reference sets frequency and speed, and by default all of the reward."""
        found = {
            **super().idle(),
            "frequencies": "the reference sets the gait of this method, not f",
            "resets": "robots of this method start at the speed of the reference",
        }
        if self.imitation.task_reward_weight == 0.0:
            found["rewards"] = "the reward is that of the style alone, as imitation.task_reward_weight is 0"
        return found

    def validate(self) -> None:
        """See :meth:`Task.validate`."""
        super().validate()
        _check_layers("imitation.discriminator_hidden_sizes", self.imitation.discriminator_hidden_sizes)


def _check_layers(name: str, sizes: tuple[int, ...]) -> None:
    """Refuse a network without a hidden layer, or with more than anybody trains."""
    if not 1 <= len(sizes) <= MAXIMUM_LAYERS:
        raise UserError(f"{name} has {len(sizes)} layers; give 1 to {MAXIMUM_LAYERS}")
