"""Fit the pattern network on gait cycles (paper, Sec. II-A.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import nn

from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import Gait, PatternNetwork, rhythm_window
from aicpg_newton.motion.cycles import GaitCycle
from aicpg_newton.robot.mirror import JOINTS


def fit_pattern_network(cycles: Sequence[GaitCycle], *, steps: int = 6000, seed: int = 0) -> PatternNetwork:
    """Supervised fit of S (paper, Sec. II-A.1): timing signals of the gaits' own frequencies to the gaits' angles.

    The cycles are symmetric, and so is the network made: S(-w) is the mirror image of S(w) at every frequency, as half
    a stride later the window changes its sign. Hidden units come in pairs that swap under the reflection, and every
    step is projected back onto such weights; a free fit is symmetric at the two gaits only, and at 0.7 Hz its sides
    differed by up to 0.2 rad.

    Args:
        cycles: The gaits, symmetric under half a stride and a reflection.
        steps: Adam steps over all samples.
        seed: Seed of the initial weights.

    Returns:
        The network; its gaits, slowest first, carry the fit errors.

    Raises:
        UserError: There are fewer than two gaits or two of the same frequency, or the angles are not finite.
    """
    cycles = sorted(cycles, key=lambda cycle: cycle.gait.frequency)
    frequencies = [cycle.gait.frequency for cycle in cycles]
    if len(set(frequencies)) < 2 or len(set(frequencies)) < len(frequencies):
        raise UserError(f"the gaits need different stride frequencies, not {frequencies} Hz; give a walk and a run")
    if not all(bool(torch.isfinite(cycle.angles).all()) for cycle in cycles):
        raise UserError("a gait holds angles that are not finite; repair the clip")
    windows = [_cycle_windows(cycle) for cycle in cycles]
    inputs, targets = torch.cat(windows), torch.cat([cycle.angles for cycle in cycles])

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = PatternNetwork()
    optimiser = torch.optim.AdamW(network.parameters(), lr=2e-3, weight_decay=0.5)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    _symmetrise(network)
    for _ in range(steps):
        optimiser.zero_grad()
        (network(inputs) - targets).square().mean().backward()
        optimiser.step()
        schedule.step()
        _symmetrise(network)
    network.requires_grad_(False).eval()
    network.gaits = tuple(_with_errors(cycle, network(window)) for cycle, window in zip(cycles, windows, strict=True))
    return network


def _cycle_windows(cycle: GaitCycle) -> torch.Tensor:
    """Timing signals at a cycle's samples, shape [samples, 50]."""
    phase = torch.arange(len(cycle.angles)) * (2 * math.pi / len(cycle.angles))
    return rhythm_window(phase, torch.full_like(phase, cycle.gait.frequency))


def _with_errors(cycle: GaitCycle, angles: torch.Tensor) -> Gait:
    """The cycle's gait with the errors of fitted angles [rad], shape [samples, 28]."""
    square = (angles - cycle.angles).square().mean(dim=0)
    return replace(cycle.gait, fit_error=float(square.mean().sqrt()), worst_fit_error=float(square.max().sqrt()))


@torch.no_grad()
def _symmetrise(network: PatternNetwork) -> None:
    """Project the weights onto S(-w) = mirror(S(w)); hidden unit i is paired with unit i + 64."""
    first, second, last = (layer for layer in network.layers if isinstance(layer, nn.Linear))

    def swap(values: torch.Tensor, dim: int) -> torch.Tensor:
        return values.roll(values.shape[dim] // 2, dims=dim)

    images = {
        first.weight: -swap(first.weight, 0),
        first.bias: swap(first.bias, 0),
        second.weight: swap(swap(second.weight, 0), 1),
        second.bias: swap(second.bias, 0),
        last.weight: JOINTS(swap(last.weight, 1).T).T,
        last.bias: JOINTS(last.bias),
    }
    for parameter, image in images.items():
        parameter.copy_(0.5 * (parameter + image))
