"""The learning rate: adapted once an iteration, within bounds; and what is said when learning runs away."""

from typing import Any

import pytest
import torch

from aicpg_newton.env.environment import Environment
from aicpg_newton.env.registry import get_task
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning.ppo import BoundedPPO, MirrorImages, Runaway
from aicpg_newton.learning.runner import Runner


def algorithm(puppet, pattern: PatternNetwork, **learning: Any) -> tuple[Runner, BoundedPPO]:
    """A runner of small networks on puppets, and its algorithm."""
    task = get_task("flat")
    settings = {"hidden_sizes": (16, 16), "steps_per_iteration": 4, "minibatches": 2, "epochs": 2, **learning}
    for name, value in settings.items():
        assert hasattr(task.learning, name)
        setattr(task.learning, name, value)
    runner = Runner(Environment(task, puppet(8), pattern), {"seed": 0})
    assert isinstance(runner.alg, BoundedPPO)
    return runner, runner.alg


@pytest.mark.parametrize(
    ("kl", "rate"),
    [(0.0, 3e-4), (0.009, 3e-4), (0.011, 2e-4), (0.039, 2e-4), (0.041, 2e-4 / 1.5)],
)
def test_the_rate_follows_the_divergence_of_a_whole_update(
    kl: float, rate: float, puppet, pattern: PatternNetwork, monkeypatch: pytest.MonkeyPatch
):
    """Half the desired divergence raises it by half, twice as much lowers it; once, however many minibatches."""
    runner, ppo = algorithm(
        puppet,
        pattern,
        learning_rate_schedule="iteration",
        learning_rate=2e-4,
        desired_kl=0.02,
        minimum_learning_rate=1e-6,
    )
    monkeypatch.setattr(ppo, "_divergence", lambda: kl)
    runner.learn(1)
    assert ppo.learning_rate == pytest.approx(rate)
    assert ppo.optimizer.param_groups[0]["lr"] == ppo.learning_rate


def test_the_desired_divergence_goes_down(puppet, pattern: PatternNetwork, monkeypatch: pytest.MonkeyPatch):
    """From the first value to the last on a straight line over iterations, and stays; a resumed run goes on there."""
    settings = {"desired_kl": 0.03, "final_kl": 0.01, "kl_decay": 4}
    runner, ppo = algorithm(puppet, pattern, **settings)
    seen: list[float] = []
    monkeypatch.setattr(ppo, "_divergence", lambda: seen.append(ppo.desired_kl) or 0.02)
    runner.learn(6)
    assert seen == pytest.approx([0.03, 0.025, 0.02, 0.015, 0.01, 0.01])
    runner, ppo = algorithm(puppet, pattern, **settings)
    runner.current_learning_iteration = 3
    monkeypatch.setattr(ppo, "_divergence", lambda: seen.append(ppo.desired_kl) or 0.02)
    runner.learn(2)
    assert seen[6:] == pytest.approx([0.015, 0.01])


@pytest.mark.parametrize("schedule", ["iteration", "minibatch"])
@pytest.mark.parametrize(("kl", "bound"), [(1e-9, 3e-4), (1e9, 1e-4)])
def test_the_rate_stays_within_its_bounds(
    schedule: str, kl: float, bound: float, puppet, pattern: PatternNetwork, monkeypatch: pytest.MonkeyPatch
):
    """Whatever the divergence is, and at every minibatch too."""
    runner, ppo = algorithm(
        puppet,
        pattern,
        learning_rate_schedule=schedule,
        learning_rate=2e-4,
        minimum_learning_rate=1e-4,
        maximum_learning_rate=3e-4,
    )
    monkeypatch.setattr(ppo, "_divergence", lambda: kl)
    monkeypatch.setattr(ppo.actor, "get_kl_divergence", lambda before, after: torch.full((4,), kl))
    monkeypatch.setattr(Runaway, "look", lambda self, losses: [])
    runner.learn(5)
    assert ppo.learning_rate == bound
    assert ppo.optimizer.param_groups[0]["lr"] == bound


def test_the_divergence_is_that_of_the_new_policy_from_the_old(puppet, pattern: PatternNetwork):
    """Moving all means by one standard deviation of 0.4 gives 28 / 2; no update at all gives nothing."""
    runner, ppo = algorithm(puppet, pattern, network="mlp", learning_rate_schedule="fixed", initial_std=0.4)
    observed = runner.env.get_observations()
    with torch.inference_mode():
        for _ in range(4):
            observed, rewards, dones, extras = runner.env.step(ppo.act(observed))
            ppo.process_env_step(observed, rewards, dones, extras)
    assert ppo._divergence() == pytest.approx(0.0, abs=1e-6)
    with torch.no_grad():
        list(ppo.actor.parameters())[-1].add_(0.4)
    assert ppo._divergence() == pytest.approx(14.0, rel=1e-3)


def test_mirror_images_are_learned_from_and_not_measured(puppet, pattern: PatternNetwork):
    """Each minibatch has twice its samples; the asymmetry is not worked out, so not logged either."""
    runner, ppo = algorithm(puppet, pattern, network="mlp", symmetry=True)
    assert isinstance(ppo.symmetry, MirrorImages)
    assert ppo.actor.distribution is not None
    sizes: list[int] = []
    update = ppo.actor.distribution.update

    def spied(mlp_output: torch.Tensor) -> None:
        sizes.append(len(mlp_output))
        update(mlp_output)

    ppo.actor.distribution.update = spied
    losses = []
    whole = ppo.update
    ppo.update = lambda: losses.append(whole()) or losses[-1]
    runner.learn(1)
    assert sizes == [8] * 4 + [32] * 4 + [32]  # acting; 2 epochs of 2 minibatches of 16; the divergence
    assert set(losses[0]) == {"value", "surrogate", "entropy", "kl"}


def test_a_diverged_update_ends_the_training_with_a_sentence(puppet, pattern: PatternNetwork):
    """Once a network is not finite, whether rsl_rl notices or not."""
    runner, ppo = algorithm(puppet, pattern)
    with torch.no_grad():
        next(ppo.critic.parameters()).fill_(float("nan"))
    with pytest.raises(UserError, match=r"learning has diverged: .* lower learning rate"):
        runner.learn(1)


def test_a_training_that_runs_away_says_so_once():
    """After ten iterations in a row, not for a single one, and not as losses grow slowly with the episodes."""
    watch = Runaway(desired_kl=0.02)
    for iteration in range(400):
        assert watch.look({"kl": 0.03, "value": 1.0 + 0.2 * iteration}) == []
    assert watch.look({"kl": 5.0, "value": 80.0}) == []
    said = [watch.look({"kl": 0.02, "value": 1e6}) for _ in range(30)]
    assert [len(each) for each in said] == [0] * 9 + [1] + [0] * 20
    assert "value loss" in said[9][0] and "lower learning rate" in said[9][0]
    said = [watch.look({"kl": 0.5, "value": 80.0}) for _ in range(12)]
    assert sum(map(len, said)) == 1 and "kl loss" in said[9][0]
    assert Runaway(desired_kl=None).look({"kl": 1e3, "value": 1.0}) == []
