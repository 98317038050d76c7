"""Adversarial motion priors (Peng et al. 2021) on rsl_rl's PPO.

A discriminator learns to tell the policy's motion from a reference gait, and the policy is paid for passing as the
reference. Defaults are those published for this humanoid (Isaac Gym examples, HumanoidAMPPPO) where nothing else is
said; which loss and reward, a setting says.
"""

from __future__ import annotations

from typing import Any

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from rsl_rl.utils import reduce_gradients_in_buckets
from tensordict import TensorDict

from aicpg_newton.env.style import reference_motion
from aicpg_newton.learning.discriminator import LOSSES, Discriminator, squared_gradient
from aicpg_newton.learning.ppo import BoundedPPO
from aicpg_newton.learning.replay import ReplayBuffer

STYLE = "style"
"""Observation group that holds the style state, shape [num_envs, N]; neither actor nor critic sees it."""

_SAVED = "motion_prior"
"""Key of everything this class adds to a checkpoint."""


class AdversarialMotionPriors(BoundedPPO):
    """PPO whose reward comes from a discriminator that is trained along with the policy.

    A step's motion is the pair of style states before and after it. The step in which an episode ends has no such pair,
    since the environment has been reset by then: a fall is paid by the task reward alone; a time-out, which rsl_rl
    bootstraps with the value of the state before, gets the style reward of the step before by the same reasoning.

    The published loss has weight 5 beside PPO's. It would change nothing: no parameter is shared, and Adam's steps do
    not depend on the scale of a loss. For the same reason a separate Adam is the published joint one, except that
    rsl_rl's adaptive learning rate keeps to the policy.

    Several processes that train together share the discriminator; each draws from its own pairs and its own replay
    buffer. The first one's buffer is in the checkpoint, and all go on with it.

    Args:
        actor: Policy network.
        critic: Value network.
        storage: Rollouts; their observations hold the group :data:`STYLE`.
        reference: Pairs of reference states one control step apart, shape [samples, 2, N].
        loss: As all up to ``task_reward_weight``, see :class:`aicpg_newton.env.task.Imitation`.
        device: Device of all networks.
        **ppo: Settings of :class:`aicpg_newton.learning.ppo.BoundedPPO`.
    """

    def __init__(
        self,
        actor: MLPModel,
        critic: MLPModel,
        storage: RolloutStorage,
        *,
        reference: torch.Tensor,
        loss: str,
        discriminator_hidden_sizes: tuple[int, ...],
        discriminator_learning_rate: float,
        discriminator_batch: int,
        gradient_penalty: float,
        logit_regularisation: float,
        weight_decay: float,
        replay_size: int,
        replay_keep: float,
        style_reward_scale: float,
        style_reward_weight: float,
        task_reward_weight: float,
        device: str = "cpu",
        **ppo: Any,
    ) -> None:
        super().__init__(actor, critic, storage, device=device, **ppo)
        self.reference = reference.to(device)
        self._loss, self._reward = LOSSES[loss]
        state_size = self.reference.shape[-1]
        self.discriminator = Discriminator(state_size, discriminator_hidden_sizes).to(device)
        self.discriminator.normaliser.update(self.reference[:, 0])
        self.discriminator.normaliser.count //= self.gpu_world_size  # each process has counted the same reference
        self.discriminator_optimizer = torch.optim.Adam(self.discriminator.parameters(), lr=discriminator_learning_rate)
        self.discriminator_batch = discriminator_batch
        self.gradient_penalty = gradient_penalty
        self.logit_regularisation = logit_regularisation
        self.weight_decay = weight_decay
        self.replay = ReplayBuffer(replay_size, state_size, device)
        self.replay_keep = replay_keep
        self.style_reward_scale = style_reward_scale
        self.style_reward_weight = style_reward_weight
        self.task_reward_weight = task_reward_weight
        # On the CPU everywhere, so that a run can be resumed on another device.
        self._generator = torch.Generator().manual_seed(int(torch.randint(2**31, ())))
        self._final_style = torch.zeros(storage.num_envs, state_size, device=device)
        self._last_reward = torch.zeros(storage.num_envs, device=device)
        self._reward_sum = torch.zeros((), device=device)

    @staticmethod
    def construct_algorithm(obs: TensorDict, env: Any, cfg: dict, device: str) -> PPO:
        """Build the algorithm as rsl_rl's runner asks.

        Args:
            obs: Observations of the environment.
            env: The environment; its ``pattern`` is the pattern network that gives the reference.
            cfg: Settings of the runner. ``cfg["algorithm"]["reference_gait"]`` names the gait to imitate, the rest are
                this class's arguments.
            device: Device of all networks.
        """
        algorithm = dict(cfg["algorithm"])
        algorithm["reference"] = reference_motion(env.pattern, algorithm.pop("reference_gait"))
        return BoundedPPO.construct_algorithm(obs, env, {**cfg, "algorithm": algorithm}, device)

    def process_env_step(
        self, obs: TensorDict, rewards: torch.Tensor, dones: torch.Tensor, extras: dict[str, Any]
    ) -> None:
        """Record one environment step with the weighted sum of task and style reward.

        Args:
            obs: Observations after the step, and after the reset where an episode ended.
            rewards: Task rewards, shape [num_envs].
            dones: Where an episode ended, shape [num_envs].
            extras: May hold ``time_outs``, shape [num_envs].
        """
        assert self.transition.observations is not None
        before, after = self.transition.observations[STYLE], obs[STYLE]
        ended = dones.bool()
        timed_out = extras["time_outs"].to(ended) if "time_outs" in extras else torch.zeros_like(ended)
        reward = torch.where(ended, 0.0, self.style_reward(torch.stack((before, after), dim=1)))
        self._reward_sum += reward.sum()
        held = torch.where(timed_out, self._last_reward, 0.0)
        self._last_reward.copy_(reward)
        self._final_style.copy_(after)
        rewards = self.task_reward_weight * rewards + self.style_reward_weight * (reward + held)
        super().process_env_step(obs, rewards, dones, extras)

    @torch.no_grad()
    def style_reward(self, pairs: torch.Tensor) -> torch.Tensor:
        """Reward for pairs of style states one control step apart, shape [batch, 2, N] to [batch]."""
        return self.style_reward_scale * self._reward(self.discriminator(pairs))

    def update(self) -> dict[str, float]:
        """Update policy and value on the collected steps, then the discriminator as many times.

        Returns:
            Mean losses and, over the iteration's pairs, the mean style reward before its weight.
        """
        pairs = self._pairs()
        mean_reward = self._reward_sum.item() / len(pairs)
        self._reward_sum.zero_()
        return {**super().update(), **self._update_discriminator(pairs), "style_reward": mean_reward}

    def _pairs(self) -> torch.Tensor:
        """States before and after each collected step that ended no episode, shape [steps, 2, N]."""
        before = self.storage.observations[STYLE]
        after = torch.cat((before[1:], self._final_style.unsqueeze(0)))
        return torch.stack((before, after), dim=2)[self.storage.dones.squeeze(-1) == 0]

    def _update_discriminator(self, pairs: torch.Tensor) -> dict[str, float]:
        """Train the discriminator on an iteration's pairs, then put them into the replay buffer."""
        network, batch = self.discriminator, self.discriminator_batch
        network.normaliser.update(torch.cat((pairs, self._draw(self.reference, len(pairs))))[:, 0])
        past = self.replay.pairs if len(self.replay.pairs) else pairs
        updates = self.num_learning_epochs * self.num_mini_batches
        totals = torch.zeros(4, device=self.device)
        for _ in range(updates):
            inputs = network.normalise(self._draw(self.reference, batch)).requires_grad_()
            reference_score = network.score(inputs)
            policy_score = network(torch.cat((self._draw(pairs, batch), self._draw(past, batch))))
            penalty = squared_gradient(reference_score, inputs)
            loss = (
                self._loss(reference_score, policy_score)
                + self.gradient_penalty * penalty
                + self.logit_regularisation * network.last.weight.square().sum()
                + self.weight_decay * torch.stack([weight.square().sum() for weight in network.weights()]).sum()
            )
            self.discriminator_optimizer.zero_grad()
            loss.backward()
            if self.is_multi_gpu:
                parameters = self.discriminator.parameters()
                reduce_gradients_in_buckets(parameters, self.gpu_world_size, self.grad_reduce_bucket_mb)
            self.discriminator_optimizer.step()
            accuracies = (reference_score > 0).float().mean(), (policy_score < 0).float().mean()
            totals += torch.stack((loss.detach(), penalty.detach(), *accuracies))
        kept = round(self.replay_keep * len(pairs)) if self.replay.full else self.replay.size
        self.replay.add(pairs[torch.randperm(len(pairs), generator=self._generator)[:kept]])
        names = ("loss", "gradient_penalty", "reference_accuracy", "policy_accuracy")
        means = dict(zip(names, (totals / updates).tolist(), strict=True))
        return {"discriminator": means.pop("loss"), **{f"discriminator_{name}": each for name, each in means.items()}}

    def _draw(self, pairs: torch.Tensor, number: int) -> torch.Tensor:
        """Pairs drawn with replacement, shape [number, 2, N]."""
        return pairs[torch.randint(len(pairs), (number,), generator=self._generator)]

    def broadcast_parameters(self) -> None:
        """Give all processes the first one's networks and normalisers."""
        super().broadcast_parameters()
        for tensor in self.discriminator.state_dict().values():
            torch.distributed.broadcast(tensor, src=0)

    def save(self) -> dict:
        """Everything needed to go on exactly: PPO's part and, under one key, the motion prior's."""
        prior = {
            "discriminator": self.discriminator.state_dict(),
            "optimizer": self.discriminator_optimizer.state_dict(),
            "replay": self.replay.state_dict(),
            "generator": self._generator.get_state(),
        }
        return {**super().save(), _SAVED: prior}

    def state_beside_networks(self) -> dict[str, Any]:
        """See :meth:`BoundedPPO.state_beside_networks`."""
        return {**super().state_beside_networks(), "last_reward": self._last_reward}

    def load_state_beside_networks(self, state: dict[str, Any]) -> None:
        """See :meth:`BoundedPPO.load_state_beside_networks`."""
        super().load_state_beside_networks(state)
        self._last_reward.copy_(state["last_reward"])

    def load(self, loaded_dict: dict, load_cfg: dict | None, strict: bool) -> bool:
        """Restore from :meth:`save`.

        Args:
            loaded_dict: What :meth:`save` returned.
            load_cfg: Parts to restore, PPO's and ``motion_prior``; None for all.
            strict: Whether all parameters must be there.
        """
        if load_cfg is None or load_cfg.get(_SAVED):
            prior = loaded_dict[_SAVED]
            self.discriminator.load_state_dict(prior["discriminator"], strict=strict)
            self.discriminator_optimizer.load_state_dict(prior["optimizer"])
            self.replay.load_state_dict(prior["replay"])
            if self.gpu_global_rank == 0:  # the others draw something else
                self._generator.set_state(prior["generator"].cpu())
        return super().load(loaded_dict, load_cfg, strict)
