"""The network that tells reference motion from the policy's, its losses and the rewards that go with them.

Least squares are those of Peng et al. (2021, Eq. 6-7). Cross-entropy and its reward are those of the Isaac Gym
examples, for which the constants of :class:`aicpg_newton.env.task.Imitation` were published. A reference that is a
single cycle is soon told from the policy's motion with certainty: there the reward of the least squares is flat at
zero, while that of the cross-entropy still says which of two motions is the better one.
"""

from __future__ import annotations

import math

import torch
from rsl_rl.modules import EmpiricalNormalization
from torch import nn
from torch.nn import functional

INPUT_LIMIT = 5.0
"""Normalised inputs are cut off here, as in the Isaac Gym examples: a fall's velocities are far from any gait's."""

GREATEST_REWARD = -math.log(1e-4)
"""Reward of the cross-entropy where the discriminator is all but certain that it sees the reference."""


class Discriminator(nn.Module):
    """MLP with ReLU from two consecutive style states to a score D, greater for reference than for the policy.

    Args:
        state_size: Length N of a style state.
        hidden_sizes: Widths of the hidden layers.
    """

    def __init__(self, state_size: int, hidden_sizes: tuple[int, ...]) -> None:
        super().__init__()
        self.normaliser = EmpiricalNormalization(state_size)
        layers: list[nn.Module] = []
        size = 2 * state_size
        for width in hidden_sizes:
            layers += [nn.Linear(size, width), nn.ReLU()]
            size = width
        self.hidden = nn.Sequential(*layers)
        self.last = nn.Linear(size, 1)

    def normalise(self, pairs: torch.Tensor) -> torch.Tensor:
        """Inputs of the layers, shape [batch, 2, N] to [batch, 2 N]."""
        return self.normaliser(pairs).clamp(-INPUT_LIMIT, INPUT_LIMIT).flatten(1)

    def score(self, inputs: torch.Tensor) -> torch.Tensor:
        """D of normalised inputs, shape [batch, 2 N] to [batch]."""
        return self.last(self.hidden(inputs)).squeeze(-1)

    def forward(self, pairs: torch.Tensor) -> torch.Tensor:
        """D of pairs of states one control step apart, shape [batch, 2, N] to [batch]."""
        return self.score(self.normalise(pairs))

    def weights(self) -> list[torch.Tensor]:
        """Weight matrices of all layers, without biases."""
        return [layer.weight for layer in (*self.hidden, self.last) if isinstance(layer, nn.Linear)]


def least_squares(reference_score: torch.Tensor, policy_score: torch.Tensor) -> torch.Tensor:
    """E[(D(reference) - 1)^2] + E[(D(policy) + 1)^2] (Eq. 6), scores of shape [batch]."""
    return (reference_score - 1).square().mean() + (policy_score + 1).square().mean()


def cross_entropy(reference_score: torch.Tensor, policy_score: torch.Tensor) -> torch.Tensor:
    """(E[-log s(D(reference))] + E[-log(1 - s(D(policy)))]) / 2 with the logistic function s, scores [batch]."""
    return (functional.softplus(-reference_score).mean() + functional.softplus(policy_score).mean()) / 2


def squared_gradient(score: torch.Tensor, inputs: torch.Tensor) -> torch.Tensor:
    """E[|dD/dx|^2] (Eq. 8 without its weight), for training.

    Args:
        score: D of the inputs, shape [batch].
        inputs: x, with ``requires_grad``, shape [batch, 2 N].
    """
    (gradient,) = torch.autograd.grad(score.sum(), inputs, create_graph=True)
    return gradient.square().sum(dim=-1).mean()


def least_squares_reward(score: torch.Tensor) -> torch.Tensor:
    """max(0, 1 - 0.25 (D - 1)^2) (Eq. 7), between 0 (D at most -1) and 1 (D = 1), shape [batch]."""
    return (1 - 0.25 * (score - 1).square()).clamp_min(0.0)


def cross_entropy_reward(score: torch.Tensor) -> torch.Tensor:
    """-log(max(1 - s(D), 1e-4)), from 0 to 9.2, shape [batch]; log 2 where the discriminator cannot tell (D = 0)."""
    return functional.softplus(score).clamp_max(GREATEST_REWARD)


LOSSES = {
    "cross_entropy": (cross_entropy, cross_entropy_reward),
    "least_squares": (least_squares, least_squares_reward),
}
"""Loss and reward by the name of the setting."""
