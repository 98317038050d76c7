"""Losses of the discriminator by hand, and that it learns."""

import math

import pytest
import torch

from aicpg_newton.learning.discriminator import (
    LOSSES,
    Discriminator,
    cross_entropy,
    cross_entropy_reward,
    least_squares,
    least_squares_reward,
    squared_gradient,
)


def test_reference_is_plus_one_and_policy_minus_one():
    """Zero loss there, and nowhere near it with the two exchanged."""
    one = torch.ones(4)
    assert least_squares(one, -one).item() == 0.0
    assert least_squares(-one, one).item() == 8.0
    assert least_squares(torch.tensor([0.5, 1.5]), torch.tensor([-1.0, 0.0])).item() == pytest.approx(0.25 + 0.5)


def test_reward_of_a_score():
    """Eq. 7 at a few scores: nothing at -1 and below, and less beyond +1."""
    rewards = least_squares_reward(torch.tensor([-3.0, -1.0, 0.0, 1.0, 2.0])).tolist()
    assert rewards == [0.0, 0.0, 0.75, 1.0, 0.75]


def test_cross_entropy():
    """By its formula with logarithms; the two exchanged cost far more, and it has no limit that it reaches."""
    reference, policy = torch.tensor([2.0, -1.0]), torch.tensor([-3.0, 0.5])
    expected = -(torch.sigmoid(reference).log().mean() + (1 - torch.sigmoid(policy)).log().mean()) / 2
    assert cross_entropy(reference, policy).item() == pytest.approx(expected.item(), rel=1e-6)
    assert cross_entropy(policy, reference) > cross_entropy(reference, policy)
    assert cross_entropy(torch.full((3,), 5.0), torch.full((3,), -5.0)) > 0


def test_cross_entropy_reward_is_flat_nowhere_but_at_its_top():
    """-log(1 - s(D)): log 2 in doubt, 9.2 at most, and more for a greater score even where that is far below zero."""
    score = torch.tensor([-8.0, -4.0, -2.0, 0.0, 4.0, 9.0, 20.0])
    rewards = cross_entropy_reward(score)
    by_hand = -torch.log((1 - torch.sigmoid(score.double())).clamp_min(1e-4)).float()
    torch.testing.assert_close(rewards, by_hand, rtol=1e-5, atol=1e-7)
    assert rewards[3].item() == pytest.approx(math.log(2)) and rewards[-1].item() == pytest.approx(9.2103, abs=1e-3)
    assert (rewards.diff()[:-1] > 0).all()


def test_a_loss_goes_with_its_reward():
    """Those that were published together."""
    assert LOSSES["cross_entropy"] == (cross_entropy, cross_entropy_reward)
    assert LOSSES["least_squares"] == (least_squares, least_squares_reward)


def test_squared_gradient_of_a_linear_network():
    """D = w x + b has the gradient w everywhere, and the penalty's own gradient is 2 w."""
    network = Discriminator(3, ())
    inputs = torch.randn(7, 6, requires_grad=True)
    penalty = squared_gradient(network.score(inputs), inputs)
    weight = network.last.weight
    assert penalty.item() == pytest.approx(weight.square().sum().item(), rel=1e-6)
    penalty.backward()
    assert weight.grad is not None
    assert torch.allclose(weight.grad, 2 * weight, rtol=1e-5)


def test_squared_gradient_of_a_layered_network():
    """Against finite differences of each input, sample by sample."""
    torch.manual_seed(0)
    network = Discriminator(2, (16,)).double()
    inputs = torch.randn(5, 4, dtype=torch.double, requires_grad=True)
    step = 1e-6 * torch.eye(4, dtype=torch.double)
    rates = [(network.score(inputs + row) - network.score(inputs - row)) / 2e-6 for row in step]
    expected = torch.stack(rates).square().sum(dim=0).mean()
    assert squared_gradient(network.score(inputs), inputs).item() == pytest.approx(expected.item(), rel=1e-6)


def test_inputs_are_normalised_and_cut_off():
    """Each number by its own mean and spread, the same before and after the step, at most 5 in size."""
    network = Discriminator(2, (8,))
    samples = torch.randn(5000, 2) * torch.tensor([3.0, 0.2]) + torch.tensor([10.0, -1.0])
    network.normaliser.update(samples)
    inputs = network.normalise(samples.reshape(2500, 2, 2))
    assert inputs.shape == (2500, 4)
    assert inputs.mean(dim=0).abs().max() < 0.1
    assert (inputs.std(dim=0) - 1).abs().max() < 0.1
    assert network.normalise(torch.full((1, 2, 2), 1e6)).tolist() == [[5.0] * 4]


def test_weights_are_those_of_all_layers():
    """Without biases."""
    shapes = [tuple(weight.shape) for weight in Discriminator(3, (8, 4)).weights()]
    assert shapes == [(8, 6), (4, 8), (1, 4)]
