"""rsl_rl's PPO with a learning rate that is adapted once an iteration, and bounded."""

from __future__ import annotations

import math
from itertools import chain
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.extensions import Symmetry
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from aicpg_newton.env.task import Schedule
from aicpg_newton.errors import UserError
from aicpg_newton.learning import distributed

_STEP = 1.5
"""Factor by which the learning rate goes up or down."""

_DIVERGED = (
    "learning has diverged: networks or losses are not finite any more; resume from the last checkpoint with a lower"
    " learning rate"
)

_PROBE = 2048
"""Number of samples that the KL divergence of an iteration is estimated from."""


class MirrorImages(Symmetry):
    """rsl_rl's mirror images without its measure of asymmetry: another pass of the actor, only to be logged."""

    def compute_loss(self, actor: MLPModel, batch: RolloutStorage.Batch, original_batch_size: int) -> torch.Tensor:
        """Nothing: see the class."""
        return torch.zeros(())


class Runaway:
    """Notices a training whose policy or value function runs away, and says so once for each.

    Args:
        desired_kl: KL divergence an iteration is meant to have; None where nothing is done about it.
    """

    PATIENCE = 10
    """Iterations in a row after which it is no accident."""
    FAR = 8.0
    """Times the desired KL divergence, four times the one at which the learning rate goes down."""
    LOSS = 100.0
    """Times its usual size, which grows a few times over as episodes get longer."""

    def __init__(self, desired_kl: float | None) -> None:
        self._desired_kl = desired_kl
        self._usual_loss: float | None = None
        self._rows = {"kl": 0, "value": 0}

    def look(self, losses: dict[str, float]) -> list[str]:
        """What is to be said after an iteration.

        Args:
            losses: Of the iteration; ``kl`` and ``value`` are looked at.
        """
        usual = losses["value"] if self._usual_loss is None else self._usual_loss
        high = {
            "kl": self._desired_kl is not None and losses["kl"] > self.FAR * self._desired_kl,
            "value": losses["value"] > self.LOSS * usual,
        }
        if not high["value"]:
            self._usual_loss = usual + 0.05 * (losses["value"] - usual)
        said = []
        for name, is_high in high.items():
            self._rows[name] = self._rows[name] + 1 if is_high else 0
            if self._rows[name] == self.PATIENCE:
                said.append(
                    f"Learning runs away: for {self.PATIENCE} iterations its {name} loss has been far above normal, at"
                    f" {losses[name]:.3g}; stop it, and resume an earlier checkpoint with a lower learning rate."
                )
        return said

    def state_dict(self) -> dict[str, Any]:
        """What it has seen."""
        return {"usual_loss": self._usual_loss, "rows": dict(self._rows)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from :meth:`state_dict`."""
        self._usual_loss, self._rows = state["usual_loss"], dict(state["rows"])


class BoundedPPO(PPO):
    """PPO whose learning rate cannot kill a training.

    rsl_rl adapts the rate at every minibatch to the KL divergence of the policy so far from the one that collected the
    samples. In the first minibatches of an iteration that is close to zero, so each of them raises the rate: with few
    minibatches it climbs to its ceiling within 50 iterations, and nothing is learned any more. Here the rate is adapted
    once, to the divergence after the whole update, and kept within bounds.

    Where several processes train together (:mod:`aicpg_newton.learning.distributed`), an update is that of one process
    with all their samples: rsl_rl averages gradients and normalisers, this class also what advantages are scaled by,
    and the divergence.

    Args:
        actor: Policy network.
        critic: Value network.
        storage: Rollouts.
        schedule: ``iteration`` as said; ``minibatch`` as rsl_rl does it, but bounded; ``fixed``.
        learning_rate_bounds: Least and greatest learning rate.
        desired_kl: KL divergence the rate is adapted to in the first iteration.
        final_kl: The same from iteration ``kl_decay`` on; on a straight line between them.
        kl_decay: Number of iterations.
        symmetry_cfg: Settings of :class:`MirrorImages`, or None.
        **ppo: Settings of :class:`rsl_rl.algorithms.PPO`.
    """

    def __init__(
        self,
        actor: MLPModel,
        critic: MLPModel,
        storage: RolloutStorage,
        *,
        schedule: Schedule,
        learning_rate_bounds: tuple[float, float],
        desired_kl: float,
        final_kl: float,
        kl_decay: int,
        symmetry_cfg: dict[str, Any] | None = None,
        **ppo: Any,
    ) -> None:
        self._bounds = learning_rate_bounds
        self._once = schedule == "iteration"
        self._kl_bounds, self._kl_decay = (desired_kl, final_kl), kl_decay
        adaptive = "adaptive" if schedule == "minibatch" else "fixed"
        super().__init__(actor, critic, storage, schedule=adaptive, desired_kl=desired_kl, **ppo)
        if symmetry_cfg is not None:
            self.symmetry = MirrorImages(**symmetry_cfg)
        self._runaway = Runaway(None if schedule == "fixed" else desired_kl)

    @property
    def learning_rate(self) -> float:
        """Rate of the next update, always within the bounds; the optimiser's own."""
        return self._learning_rate

    @learning_rate.setter
    def learning_rate(self, rate: float) -> None:
        low, high = self._bounds
        self._learning_rate = min(max(rate, low), high)
        for group in self.optimizer.param_groups:
            group["lr"] = self._learning_rate

    def begin_iteration(self, number: int) -> None:
        """Set the desired KL divergence of an iteration, counted from 0 over the whole run."""
        first, final = self._kl_bounds
        self.desired_kl = first + min(number / self._kl_decay, 1.0) * (final - first)

    def compute_returns(self, obs: TensorDict) -> None:
        """Returns and advantages of the collected steps; the latter are standardised over all processes."""
        super().compute_returns(obs)
        if self.is_multi_gpu and not self.normalize_advantage_per_mini_batch:
            self.storage.advantages = distributed.standardised(self.storage.returns - self.storage.values)

    def update(self) -> dict[str, float]:
        """Learn from the collected steps, then adapt the learning rate.

        Returns:
            Mean losses, and under ``kl`` the divergence of the new policy from the one that collected the steps.

        Raises:
            UserError: Learning has diverged.
        """
        try:
            losses = super().update()
            losses.pop("symmetry", None)
            kl = losses["kl"] = self._divergence()
        except RuntimeError as error:  # torch refuses to draw actions from what is not a number
            if self._sound():
                raise
            raise UserError(_DIVERGED) from error
        if not (self._sound() and all(map(math.isfinite, losses.values()))):
            raise UserError(_DIVERGED)
        for sentence in self._runaway.look(losses):
            print(sentence)
        if self._once:
            if kl > 2.0 * self.desired_kl:
                self.learning_rate /= _STEP
            elif kl < 0.5 * self.desired_kl:
                self.learning_rate *= _STEP
        return losses

    def state_beside_networks(self) -> dict[str, Any]:
        """What goes on from iteration to iteration and is not in :meth:`save`, as it goes with the robots' state."""
        return {"runaway": self._runaway.state_dict()}

    def load_state_beside_networks(self, state: dict[str, Any]) -> None:
        """Go on from :meth:`state_beside_networks`."""
        self._runaway.load_state_dict(state["runaway"])

    def _sound(self) -> bool:
        """Whether all parameters are finite."""
        return all(
            bool(torch.isfinite(each).all()) for each in chain(self.actor.parameters(), self.critic.parameters())
        )

    @torch.no_grad()
    def _divergence(self) -> float:
        """Mean KL divergence of the policy from the one that collected the steps, over a part of them."""
        storage = self.storage
        assert storage.distribution_params is not None
        seen = storage.observations.flatten(0, 1)
        picked = torch.randint(len(seen), (min(_PROBE, len(seen)),), device=self.device)
        before = tuple(values.flatten(0, 1)[picked] for values in storage.distribution_params)
        self.actor(seen[picked], stochastic_output=True)
        here = self.actor.get_kl_divergence(before, self.actor.output_distribution_params).mean()
        return distributed.mean(here).item()
