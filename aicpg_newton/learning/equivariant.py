"""Equivariant networks: left-right symmetric by construction, as models of rsl_rl.

A mirrored observation gives exactly the mirrored action (actor) and the same value (critic), before, during and after
training, so no mirror images are needed to learn it.
"""

# No "from __future__ import annotations" here: TorchScript reads the annotations of buffers.
import math
from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from rsl_rl.modules.distribution import GaussianDistribution
from rsl_rl.utils import resolve_nn_activation
from tensordict import TensorDict
from torch import nn
from torch.distributions import Normal

from aicpg_newton.robot.mirror import EVEN, JOINTS, Mirror


def halves(mirror: Mirror) -> tuple[torch.Tensor, torch.Tensor]:
    """The orthonormal basis of half sums and half differences of mirrored pairs, in which a mirror only turns signs.

    Args:
        mirror: Permutation and sign, of length N.

    Returns:
        What stays as it is in the mirror, shape [S, N], and what turns its sign, shape [A, N], with S + A = N.
    """
    permutation, sign = mirror
    identity = torch.eye(len(permutation))
    mirrored = torch.tensor(sign).unsqueeze(1) * identity[list(permutation)]
    # One row for each pair, that of its first member; what is its own mirror image stays or turns its sign.
    pairs = [i for i, j in enumerate(permutation) if i < j]
    stays, turns = ([i for i, j in enumerate(permutation) if i == j and sign[i] == own] for own in (1.0, -1.0))
    even, odd = (identity + mirrored)[pairs + stays], (identity - mirrored)[pairs + turns]
    return even / even.norm(dim=1, keepdim=True), odd / odd.norm(dim=1, keepdim=True)


class MirrorLinear(nn.Module):
    """A linear layer that commutes with the mirror: one matrix for the symmetric part, one for the antisymmetric part.

    Only the symmetric part can have a bias. Hidden layers hold right + left and right - left, which are the orthonormal
    parts times the root of two; the factors that this takes are put on the weights, as they are smaller than a batch.

    Args:
        inputs: Lengths of the symmetric and of the antisymmetric part.
        outputs: The same of what it gives.
        from_hidden: Whether the inputs are those of a hidden layer.
        to_hidden: Whether the outputs are to be those of a hidden layer.
    """

    def __init__(
        self, inputs: tuple[int, int], outputs: tuple[int, int], *, from_hidden: bool, to_hidden: bool
    ) -> None:
        super().__init__()
        self.symmetric = nn.Parameter(torch.empty(outputs[0], inputs[0]))
        self.antisymmetric = nn.Parameter(torch.empty(outputs[1], inputs[1]))
        self.bias = nn.Parameter(torch.empty(outputs[0]))
        # As an ordinary layer of this size begins; right and left then have the variance of a layer of both.
        for weights, size in ((self.symmetric, inputs[0]), (self.antisymmetric, inputs[1]), (self.bias, inputs[0])):
            nn.init.uniform_(weights, -1.0 / math.sqrt(max(size, 1)), 1.0 / math.sqrt(max(size, 1)))
        self.bias_factor = math.sqrt(0.5) if to_hidden else 1.0
        self.factor = self.bias_factor * (math.sqrt(0.5) if from_hidden else 1.0)

    def forward(self, even: torch.Tensor, odd: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Symmetric and antisymmetric part of the outputs, each of shape [batch, ...]."""
        return (
            nn.functional.linear(even, self.factor * self.symmetric, self.bias_factor * self.bias),
            nn.functional.linear(odd, self.factor * self.antisymmetric),
        )


class EquivariantMLP(nn.Module):
    """Layers that commute with the mirror; a hidden layer has a right and a left half that swap.

    In the basis of :func:`halves` such a layer is two matrices of half the width, so half the multiplications of an
    ordinary layer. The activation acts on the right and left halves.

    Args:
        inputs: Mirror map of the inputs.
        outputs: Mirror map of the outputs.
        hidden_sizes: Widths of the hidden layers, even numbers.
        activation: Activation function, by rsl_rl's name.
    """

    even_input: torch.Tensor
    odd_input: torch.Tensor
    even_output: torch.Tensor
    odd_output: torch.Tensor

    def __init__(self, inputs: Mirror, outputs: Mirror, hidden_sizes: list[int], activation: str) -> None:
        super().__init__()
        for name, mirror in (("input", inputs), ("output", outputs)):
            for part, basis in zip(("even", "odd"), halves(mirror), strict=True):
                self.register_buffer(f"{part}_{name}", basis, persistent=False)
        self.activation = resolve_nn_activation(activation)
        sizes = [
            (len(self.even_input), len(self.odd_input)),
            *((width // 2, width // 2) for width in hidden_sizes),
            (len(self.even_output), len(self.odd_output)),
        ]
        last = len(hidden_sizes)
        self.hidden = nn.ModuleList(
            MirrorLinear(sizes[i], sizes[i + 1], from_hidden=i > 0, to_hidden=True) for i in range(last)
        )
        self.last = MirrorLinear(sizes[last], sizes[last + 1], from_hidden=last > 0, to_hidden=False)

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Outputs, shape [batch, M], of inputs, shape [batch, N]."""
        even, odd = values @ self.even_input.T, values @ self.odd_input.T
        for layer in self.hidden:
            even, odd = layer(even, odd)
            right, left = self.activation(even + odd), self.activation(even - odd)
            even, odd = right + left, right - left
        even, odd = self.last(even, odd)
        return even @ self.even_output + odd @ self.odd_output


class SymmetricNormalization(EmpiricalNormalization):
    """Mean and standard deviation as of the inputs and their mirror images together.

    Args:
        mirror: Mirror map of the inputs.
    """

    permutation: torch.Tensor
    sign: torch.Tensor

    def __init__(self, mirror: Mirror) -> None:
        super().__init__(len(mirror[0]))
        self.register_buffer("permutation", torch.tensor(mirror[0]), persistent=False)
        self.register_buffer("sign", torch.tensor(mirror[1]), persistent=False)

    @torch.jit.unused
    def update(self, x: torch.Tensor) -> None:
        """Learn from inputs, shape [batch, N]."""
        if not self.training:
            return
        super().update(x)
        mean, variance = self._mean, self._var
        mirrored = mean[:, self.permutation] * self.sign
        # Both means lie as far from the common one: the law of total variance.
        self._mean = 0.5 * (mean + mirrored)
        self._var = 0.5 * (variance + variance[:, self.permutation]) + (0.5 * (mean - mirrored)).square()
        self._std = torch.sqrt(self._var)


class SymmetricGaussian(GaussianDistribution):
    """Exploration with one standard deviation for a joint and its mirror image."""

    permutation: torch.Tensor

    def __init__(self, output_dim: int, **others: Any) -> None:
        super().__init__(output_dim, **others)
        self.register_buffer("permutation", torch.tensor(JOINTS.permutation), persistent=False)

    def update(self, mlp_output: torch.Tensor) -> None:
        """See :meth:`GaussianDistribution.update`."""
        both = 0.5 * (self.log_std_param + self.log_std_param.index_select(0, self.permutation))
        self._distribution = Normal(mlp_output, both.clamp(*self.log_std_range).exp())


class EquivariantModel(MLPModel):
    """Actor or critic whose network, normaliser and exploration are symmetric.

    Args:
        obs: Observations.
        obs_groups: Groups of observations of each set.
        obs_set: ``actor`` or ``critic``.
        output_dim: 28 actions, or one value.
        hidden_dims: Widths of the hidden layers.
        activation: Activation function.
        mirror: Mirror of the observations.
        **others: As :class:`rsl_rl.models.MLPModel`.
    """

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        hidden_dims: list[int],
        activation: str,
        *,
        mirror: Mirror,
        **others: Any,
    ) -> None:
        super().__init__(obs, obs_groups, obs_set, output_dim, hidden_dims, activation, **others)
        self.mlp = EquivariantMLP(mirror, JOINTS if output_dim > 1 else EVEN, hidden_dims, activation)
        self.obs_normalizer = SymmetricNormalization(mirror)
