"""Symmetry augmentation and rsl_rl's configuration."""

import torch
from rsl_rl.modules import MLP
from tensordict import TensorDict

from aicpg_newton.env.methods import with_method
from aicpg_newton.env.observations import BODY, PATTERN, mirror_of
from aicpg_newton.env.task import Learning, Task
from aicpg_newton.learning.settings import WithMirrorImages, runner_settings
from aicpg_newton.robot.mirror import JOINTS

MIRROR = mirror_of((*BODY, *PATTERN))


def test_mirror_images_follow_the_originals():
    """Twice the batch: originals first, then their mirror images; either argument may be missing."""
    seen, actions = torch.randn(4, 192), torch.randn(4, 28)
    doubled, doubled_actions = WithMirrorImages(MIRROR)(None, TensorDict({"policy": seen}, batch_size=[4]), actions)
    assert doubled is not None and doubled_actions is not None
    assert doubled.batch_size == (8,)
    assert torch.equal(doubled["policy"][:4], seen)
    assert torch.equal(doubled["policy"][4:], MIRROR(seen))
    assert torch.equal(doubled_actions[4:], JOINTS(actions))
    assert WithMirrorImages(MIRROR)(None, None, actions)[0] is None
    assert WithMirrorImages(MIRROR)(None, TensorDict({"policy": seen}, batch_size=[4]), None)[1] is None


def test_learning_from_mirror_images_makes_a_symmetric_network():
    """Toy problem: fitted to one-sided data with augmentation, mirrored observations give mirrored actions."""
    torch.manual_seed(0)
    rule = torch.randn(192, 28) / 14
    network = MLP(192, 28, [64], "relu")
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    seen = torch.randn(256, 192)
    seen[:, 27] = seen[:, 27].abs()  # one joint angle always positive: the data themselves are not symmetric
    actions = torch.tanh(seen @ rule)

    def asymmetry() -> float:
        with torch.no_grad():
            return float((network(MIRROR(seen)) - JOINTS(network(seen))).abs().mean())

    before = asymmetry()
    doubled, doubled_actions = WithMirrorImages(MIRROR)(None, TensorDict({"policy": seen}, batch_size=[256]), actions)
    assert doubled is not None and doubled_actions is not None
    for _ in range(600):
        optimiser.zero_grad()
        loss = (network(doubled["policy"]) - doubled_actions).square().mean()
        loss.backward()
        optimiser.step()
    assert loss.item() < 0.01
    assert asymmetry() < 0.1 < 4 * asymmetry() + before
    one_sided = MLP(192, 28, [64], "relu")
    optimiser = torch.optim.Adam(one_sided.parameters(), lr=3e-3)
    for _ in range(600):
        optimiser.zero_grad()
        (one_sided(seen) - actions).square().mean().backward()
        optimiser.step()
    network = one_sided
    assert asymmetry() > 0.3


def test_settings_reach_rsl_rl():
    """Numbers of the task stand where rsl_rl looks for them, and mirror images are for ordinary networks alone."""
    learning = Learning(
        network="mlp",
        learning_rate=2e-4,
        hidden_sizes=(32, 16),
        critic_hidden_sizes=(8,),
        activation="elu",
        steps_per_iteration=7,
        learning_rate_schedule="fixed",
        minimum_learning_rate=1e-4,
        maximum_learning_rate=3e-4,
    )
    task = with_method(Task(name="test", learning=learning), "ai-cpg")
    settings = runner_settings(task, MIRROR, seed=5)
    assert settings["algorithm"]["learning_rate"] == 2e-4
    assert settings["algorithm"]["learning_rate_bounds"] == (1e-4, 3e-4)
    assert settings["algorithm"]["schedule"] == "fixed"
    assert settings["actor"]["hidden_dims"] == [32, 16]
    assert settings["critic"]["hidden_dims"] == [8]
    assert settings["actor"]["class_name"] == "MLPModel"
    assert settings["num_steps_per_env"] == 7
    assert settings["algorithm"]["symmetry_cfg"]["use_data_augmentation"] is True
    assert settings["algorithm"]["use_clipped_value_loss"] is False
    learning.symmetry, learning.value_clipping, learning.critic_hidden_sizes = False, True, ()
    settings = runner_settings(task, MIRROR, seed=5)
    assert settings["algorithm"]["use_clipped_value_loss"] is True
    assert settings["algorithm"]["symmetry_cfg"] is None
    assert settings["critic"]["hidden_dims"] == [32, 16]
    learning.network, learning.symmetry = "equivariant", True
    settings = runner_settings(task, MIRROR, seed=5)
    assert all(settings[name]["class_name"].endswith(":EquivariantModel") for name in ("actor", "critic"))
    assert settings["algorithm"]["symmetry_cfg"] is None
