"""Adversarial motion priors on a made-up environment: pairs, rewards, learning, and exact continuation."""

import copy
import io
import math
from dataclasses import asdict
from typing import Any

import pytest
import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

from aicpg_newton.env.style import BLOCKS, reference_motion
from aicpg_newton.env.task import Imitation
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning.amp import AdversarialMotionPriors

STEPS, NUM_ENVS = 8, 16
STYLE_SIZE = sum(block.mirror.size for block in BLOCKS)


class MadeUpEnvironment(VecEnv):
    """Observations, style states and ends of episodes that depend on the number of steps done and nothing else."""

    def __init__(self, pattern: PatternNetwork, clock: int = 0) -> None:
        self.pattern = pattern
        self.num_envs, self.num_actions, self.max_episode_length = NUM_ENVS, 2, 1000
        self.device, self.cfg = torch.device("cpu"), {}
        self.episode_length_buf = torch.zeros(NUM_ENVS, dtype=torch.long)
        self.clock = clock

    def get_observations(self) -> TensorDict:
        """Drawn from a generator that is seeded by the clock."""
        generator = torch.Generator().manual_seed(self.clock)
        groups = {
            "policy": torch.randn(NUM_ENVS, 5, generator=generator),
            "style": torch.randn(NUM_ENVS, STYLE_SIZE, generator=generator),
        }
        return TensorDict(groups, batch_size=[NUM_ENVS])

    def ends(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Falls in environment 1 and time-outs in environment 2, both at every fourth step."""
        due = self.clock % 4 == 0
        number = torch.arange(NUM_ENVS)
        return due & (number == 1), due & (number == 2)

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict]:
        """Task reward 1, except for falls."""
        self.clock += 1
        fallen, timed_out = self.ends()
        return self.get_observations(), (~fallen).float(), (fallen | timed_out).long(), {"time_outs": timed_out}


def settings(**changes: Any) -> dict[str, Any]:
    """The runner's settings with small networks."""
    network = {"class_name": "MLPModel", "hidden_dims": [8], "activation": "relu", "obs_normalization": True}
    noise = {"init_std": math.exp(-2.9), "std_type": "log", "learn_std": False}
    algorithm = {
        "class_name": "aicpg_newton.learning.amp:AdversarialMotionPriors",
        **asdict(Imitation()),
        "reference_gait": "run",
        "num_learning_epochs": 2,
        "num_mini_batches": 2,
        "schedule": "fixed",
        "learning_rate_bounds": (1e-5, 1e-2),
        **{"desired_kl": 0.01, "final_kl": 0.01, "kl_decay": 1},
        "learning_rate": 1e-3,
        "discriminator_hidden_sizes": [32, 16],
        "discriminator_learning_rate": 1e-3,
        "discriminator_batch": 64,
        "replay_size": 150,
        "replay_keep": 0.25,
        "style_reward_weight": 1.0,
    }
    return {
        "num_steps_per_env": STEPS,
        "save_interval": 50,
        "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
        "actor": {**network, "distribution_cfg": {"class_name": "GaussianDistribution", **noise}},
        "critic": network,
        "algorithm": {**algorithm, **changes},
    }


def made_up_runner(pattern: PatternNetwork, clock: int = 0, **changes: Any) -> OnPolicyRunner:
    """rsl_rl's runner, which finds the algorithm by name."""
    return OnPolicyRunner(MadeUpEnvironment(pattern, clock), settings(**changes))


def prior_of(runner: OnPolicyRunner) -> AdversarialMotionPriors:
    """The runner's algorithm."""
    assert isinstance(runner.alg, AdversarialMotionPriors)
    return runner.alg


def collect(runner: OnPolicyRunner) -> None:
    """The steps of an iteration as the runner does them, without an update."""
    with torch.inference_mode():
        observed = runner.env.get_observations()
        for _ in range(STEPS):
            observed, rewards, dones, extras = runner.env.step(runner.alg.act(observed))
            runner.alg.process_env_step(observed, rewards, dones, extras)
        runner.alg.compute_returns(observed)


def train_discriminator(prior: AdversarialMotionPriors, negatives: torch.Tensor, rounds: int) -> dict[str, float]:
    """Losses after some iterations' worth of updates against given pairs."""
    losses = {}
    for _ in range(rounds):
        losses = prior._update_discriminator(negatives)
    return losses


def test_settings_stay_plain(pattern: PatternNetwork):
    """The reference is built from the environment's pattern network and does not get into the settings."""
    given = settings()
    before = copy.deepcopy(given)
    runner = OnPolicyRunner(MadeUpEnvironment(pattern), given)
    assert given["algorithm"] == before["algorithm"]
    assert torch.equal(prior_of(runner).reference, reference_motion(pattern, "run"))


def test_losses_have_names_that_rsl_rl_logs(pattern: PatternNetwork):
    """Beside PPO's; accuracies and the reward lie in their ranges, and the fixed noise stays where it was."""
    runner = made_up_runner(pattern)
    collect(runner)
    losses = runner.alg.update()
    added = {"discriminator", "style_reward"}
    added |= {f"discriminator_{name}" for name in ("gradient_penalty", "reference_accuracy", "policy_accuracy")}
    assert {"value", "surrogate", "entropy", "kl"} | added == set(losses)
    assert all(math.isfinite(value) for value in losses.values())
    assert 0 <= losses["style_reward"] <= 2
    assert 0 <= losses["discriminator_policy_accuracy"] <= 1
    assert runner.alg.get_policy().output_std.unique().log().tolist() == pytest.approx([-2.9])


def test_pairs_across_resets_are_left_out(pattern: PatternNetwork):
    """Every other step gives its states before and after, the last step of the iteration too."""
    runner = made_up_runner(pattern)
    collect(runner)
    style = [MadeUpEnvironment(pattern, clock).get_observations()["style"] for clock in range(STEPS + 1)]
    expected = []
    for step in range(STEPS):
        fallen, timed_out = MadeUpEnvironment(pattern, step + 1).ends()
        expected.append(torch.stack((style[step], style[step + 1]), dim=1)[~(fallen | timed_out)])
    pairs = prior_of(runner)._pairs()
    assert len(pairs) == STEPS * NUM_ENVS - 2 * (STEPS // 4)
    assert torch.equal(pairs, torch.cat(expected))


def test_rewards(pattern: PatternNetwork):
    """Weighted sum of both; a fall has no style reward, a time-out that of the step before and the value."""
    runner = made_up_runner(pattern, style_reward_weight=0.5, task_reward_weight=0.25, gamma=0.9)
    collect(runner)
    prior, storage = prior_of(runner), runner.alg.storage
    last, total = torch.zeros(NUM_ENVS), torch.zeros(())
    for step in range(STEPS):
        before, after = (MadeUpEnvironment(pattern, step + i).get_observations()["style"] for i in (0, 1))
        fallen, timed_out = MadeUpEnvironment(pattern, step + 1).ends()
        style = prior.style_reward(torch.stack((before, after), dim=1))
        assert torch.all(style[fallen | timed_out] > 0)
        style[fallen] = 0
        style[timed_out] = last[timed_out]
        expected = 0.5 * style + 0.25 * ~fallen + 0.9 * storage.values[step, :, 0] * timed_out
        assert torch.allclose(storage.rewards[step, :, 0], expected, atol=1e-6)
        last = torch.where(fallen | timed_out, 0.0, style)
        total += last.sum()
    mean = (total / (STEPS * NUM_ENVS - 2 * (STEPS // 4))).item()
    assert runner.alg.update()["style_reward"] == pytest.approx(mean, rel=1e-5)


def test_without_time_outs_in_extras(pattern: PatternNetwork):
    """Then every end is a fall."""
    prior = prior_of(made_up_runner(pattern))
    observed = MadeUpEnvironment(pattern).get_observations()
    prior.act(observed)
    prior.process_env_step(observed, torch.ones(NUM_ENVS), torch.ones(NUM_ENVS).long(), {})
    assert prior.storage.rewards[0].abs().max() == 0


def test_reference_passes_and_random_motion_does_not(pattern: PatternNetwork):
    """Trained against made-up motion: replaying the reference earns more than doubt does, random motion less.

    The made-up states have the reference's own mean and spread in every number, so that no single one tells them apart.
    """
    torch.manual_seed(0)
    prior = prior_of(made_up_runner(pattern))
    states = prior.reference.flatten(0, 1)
    random = states.mean(dim=0) + states.std(dim=0) * torch.randn(2048, 2, STYLE_SIZE)
    losses = train_discriminator(prior, random, rounds=60)
    assert losses["discriminator_reference_accuracy"] > 0.98
    assert losses["discriminator_policy_accuracy"] > 0.98
    phases_between = reference_motion(pattern, "run", phases=77)
    doubt = 2.0 * math.log(2.0)
    assert prior.style_reward(phases_between).mean() > doubt + 0.5
    assert prior.style_reward(random).mean() < doubt - 0.3


def test_order_in_time_counts(pattern: PatternNetwork):
    """The reference played backwards, velocities and all other numbers unchanged, is told apart from the reference."""
    torch.manual_seed(0)
    prior = prior_of(made_up_runner(pattern, gradient_penalty=0.1))
    backwards = prior.reference.flip(1)
    train_discriminator(prior, backwards, rounds=80)
    assert prior.style_reward(prior.reference).mean() > prior.style_reward(backwards).mean() + 0.5


def test_normaliser_sees_both_motions_alike(pattern: PatternNetwork):
    """Half of what it has seen is reference, whatever the number of steps."""
    prior = prior_of(made_up_runner(pattern))
    for _ in range(50):
        prior._update_discriminator(torch.full((600, 2, STYLE_SIZE), 40.0))
    expected = 0.5 * (prior.reference[:, 0].mean(dim=0) + 40.0)
    assert torch.allclose(prior.discriminator.normaliser.mean, expected, rtol=0.02)


def test_a_full_replay_buffer_takes_a_share(pattern: PatternNetwork):
    """The first iterations fill it, later ones add a quarter of their pairs, here; never more than fit."""
    prior = prior_of(made_up_runner(pattern))
    for number in range(1, 4):
        prior._update_discriminator(torch.full((100, 2, STYLE_SIZE), float(number)))
        counts = [int((prior.replay.pairs[:, 0, 0] == each).sum()) for each in (1, 2, 3)]
        assert counts == [[100, 0, 0], [50, 100, 0], [25, 100, 25]][number - 1]
    prior = prior_of(made_up_runner(pattern))
    prior._update_discriminator(torch.zeros(1000, 2, STYLE_SIZE))
    assert len(prior.replay.pairs) == 150


def through_a_file(content: dict[str, Any]) -> dict[str, Any]:
    """Written and read as the project's checkpoints are."""
    file = io.BytesIO()
    torch.save(content, file)
    file.seek(0)
    return torch.load(file, weights_only=True)


def test_resume_is_exact(pattern: PatternNetwork, monkeypatch: pytest.MonkeyPatch):
    """The third iteration has the same losses and parameters in the same process and in a restored one."""
    torch.manual_seed(1)
    runner = made_up_runner(pattern)
    runner.learn(2)
    saved = through_a_file(runner.alg.save())
    torch.manual_seed(99)
    restored = made_up_runner(pattern, clock=2 * STEPS)
    restored.alg.load(saved, load_cfg=None, strict=True)
    losses: list[dict[str, float]] = []
    for each in (runner, restored):
        update = each.alg.update
        monkeypatch.setattr(each.alg, "update", lambda update=update: losses.append(update()) or losses[-1])
        torch.manual_seed(7)
        each.learn(1)
    assert losses[0] == pytest.approx(losses[1], rel=1e-6, abs=1e-9)
    assert losses[0]["discriminator"] > 0
    first, second = (prior_of(each).save()["motion_prior"] for each in (runner, restored))
    assert all(torch.equal(first["discriminator"][name], value) for name, value in second["discriminator"].items())
    assert torch.equal(first["replay"]["pairs"], second["replay"]["pairs"])
    assert torch.equal(first["generator"], second["generator"])


def test_loading_the_actor_alone(pattern: PatternNetwork):
    """For playing: the motion prior may even be missing."""
    runner, player = made_up_runner(pattern), made_up_runner(pattern)
    saved = runner.alg.save()
    del saved["motion_prior"]
    player.alg.load(saved, load_cfg={"actor": True}, strict=True)
    observed = MadeUpEnvironment(pattern).get_observations()
    assert torch.equal(player.get_inference_policy()(observed), runner.get_inference_policy()(observed))


def doubled(
    env: Any, obs: TensorDict | None, actions: torch.Tensor | None
) -> tuple[TensorDict | None, torch.Tensor | None]:
    """A symmetry of the made-up environment, of which it knows the policy's observations alone."""
    if obs is not None:
        obs = TensorDict({"policy": torch.cat((obs["policy"], -obs["policy"]))}, batch_size=[2 * len(obs)])
    return obs, None if actions is None else torch.cat((actions, -actions))


def test_symmetry_goes_on_working(pattern: PatternNetwork):
    """rsl_rl's augmentation needs no style states."""
    symmetry = {"data_augmentation_func": doubled, "use_data_augmentation": True}
    runner = made_up_runner(pattern, symmetry_cfg=symmetry)
    collect(runner)
    assert math.isfinite(runner.alg.update()["surrogate"])
    assert len(runner.alg.actor.output_std) == STEPS * NUM_ENVS  # the divergence, of the original samples alone


def test_mistakes(pattern: PatternNetwork):
    """A gait that does not exist."""
    with pytest.raises(UserError, match="no gait 'hop'"):
        made_up_runner(pattern, reference_gait="hop")
