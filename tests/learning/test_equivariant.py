"""Networks that are symmetric by construction: before, during and after learning, resumed and exported."""

from pathlib import Path

import pytest
import torch
from rsl_rl.modules import MLP
from tensordict import TensorDict

from aicpg_newton.env.environment import Environment
from aicpg_newton.env.observations import BODY, PATTERN, mirror_of
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import Task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.equivariant import (
    EquivariantMLP,
    EquivariantModel,
    SymmetricNormalization,
    halves,
)
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.runner import Runner
from aicpg_newton.learning.settings import runner_settings
from aicpg_newton.learning.training import train
from aicpg_newton.robot.mirror import JOINTS

MIRROR = mirror_of((*BODY, *PATTERN))


def small_task() -> Task:
    """The flat task with little learning."""
    task = get_task("flat")
    assert task.learning.network == "equivariant"
    task.learning.hidden_sizes = (32, 16)
    task.learning.steps_per_iteration = 8
    task.learning.minibatches = 2
    return task


def lopsided_runner(puppet, pattern: PatternNetwork) -> Runner:
    """A runner whose robots all lean to the right, so that nothing in the samples is symmetric."""
    engine = puppet(16)
    engine.overrides["foot_force"] = torch.tensor([[100.0, 50.0, 400.0], [0.0, 0.0, 0.0]]).expand(16, 2, 3)
    engine.overrides["root_linear_velocity"] = torch.tensor([1.0, -0.4, 0.1]).expand(16, 3)
    return Runner(Environment(small_task(), engine, pattern), {"seed": 0})


def asymmetry(runner: Runner) -> float:
    """Largest difference between what is done in the mirror and the mirror image of what is done, for likely states."""
    actor, critic = runner.alg.actor, runner.alg.critic
    assert isinstance(actor.obs_normalizer, SymmetricNormalization)
    seen = actor.obs_normalizer.mean + 2.0 * actor.obs_normalizer.std * torch.randn(200, 192)
    one, other = (TensorDict({"policy": each}, batch_size=[len(each)]) for each in (seen, MIRROR(seen)))
    with torch.no_grad():
        action, value = JOINTS(actor(one)) - actor(other), critic(one) - critic(other)
    return float(torch.cat((action, value), dim=1).abs().max())


def test_halves_are_an_orthonormal_basis_in_which_the_mirror_turns_signs():
    """For the observations and the joints: 28 joints have 11 pairs, two of the trunk stay and four turn."""
    for mirror in (MIRROR, mirror_of(BODY), JOINTS):
        even, odd = halves(mirror)
        both = torch.cat((even, odd))
        size = len(mirror[0])
        torch.testing.assert_close(both @ both.T, torch.eye(size))
        reflection = torch.tensor(mirror[1]).unsqueeze(1) * torch.eye(size)[list(mirror[0])]
        torch.testing.assert_close(even @ reflection.T, even)
        torch.testing.assert_close(odd @ reflection.T, -odd)
    assert [len(part) for part in halves(JOINTS)] == [13, 15]


def test_an_equivariant_layer_starts_as_an_ordinary_one():
    """Outputs spread as widely as those of rsl_rl's MLP of the same widths, with fewer than 60 % of its weights."""
    torch.manual_seed(0)
    seen = torch.randn(2000, 192)
    ordinary = [MLP(192, 28, [512, 256, 128], "relu") for _ in range(5)]
    symmetric = [EquivariantMLP(MIRROR, JOINTS, [512, 256, 128], "relu") for _ in range(5)]
    with torch.no_grad():
        spread = [sum(float(network(seen).std()) for network in group) for group in (ordinary, symmetric)]
    assert spread[1] == pytest.approx(spread[0], rel=0.25)
    sizes = [sum(weights.numel() for weights in group[0].parameters()) for group in (ordinary, symmetric)]
    assert 0.45 * sizes[0] < sizes[1] < 0.6 * sizes[0]


@pytest.mark.parametrize("activation", ["relu", "elu", "tanh"])
def test_a_symmetric_rule_can_be_fitted(activation: str):
    """A made-up symmetric rule is learned to less than a quarter of its spread, and stays symmetric."""
    torch.manual_seed(1)
    rule, shift = torch.randn(192, 28) / 14, 0.5 * torch.randn(28)

    def whole(seen: torch.Tensor) -> torch.Tensor:
        return torch.tanh(seen @ rule + shift)

    seen = torch.randn(512, 192)
    wanted = 0.5 * (whole(seen) + JOINTS(whole(MIRROR(seen))))
    network = EquivariantMLP(MIRROR, JOINTS, [64, 64], activation)
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    loss = torch.zeros(())
    for _ in range(400):
        optimiser.zero_grad()
        loss = (network(seen) - wanted).square().mean()
        loss.backward()
        optimiser.step()
    assert loss.item() < 0.05 * float(wanted.var())
    with torch.no_grad():
        mirrored = network(MIRROR(seen))
        torch.testing.assert_close(mirrored, JOINTS(network(seen)), atol=1e-5, rtol=0.0)


def test_the_normaliser_learns_as_if_from_mirror_images_too():
    """Mean and deviation are those of the samples and their mirror images, and exactly symmetric."""
    mirror = MIRROR
    normaliser = SymmetricNormalization(mirror)
    samples = torch.randn(5, 64, 192) * torch.rand(192) + torch.randn(192)
    for batch in samples:
        normaliser.update(batch)
    everything = samples.flatten(0, 1)
    everything = torch.cat((everything, MIRROR(everything)))
    torch.testing.assert_close(normaliser.mean, everything.mean(dim=0), atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(normaliser.std, everything.std(dim=0), atol=1e-3, rtol=1e-3)
    assert torch.equal(MIRROR(normaliser.mean), normaliser.mean)
    assert torch.equal(normaliser.std[list(mirror[0])], normaliser.std)
    normaliser.eval()
    before = normaliser.mean
    normaliser.update(everything)
    assert torch.equal(normaliser.mean, before)


def test_symmetric_before_during_and_after_learning(puppet, pattern: PatternNetwork):
    """Outputs, normaliser and exploration, though the samples lean to one side; and learning does change them."""
    runner = lopsided_runner(puppet, pattern)
    seen = TensorDict({"policy": torch.randn(200, 192)}, batch_size=[200])
    first = runner.decide(seen)
    for _ in range(4):
        assert asymmetry(runner) < 1e-5
        runner.learn(3)
    assert asymmetry(runner) < 1e-5
    assert float((runner.decide(seen) - first).abs().max()) > 0.01
    for model in (runner.alg.actor, runner.alg.critic):
        assert isinstance(model, EquivariantModel)
        normaliser = model.obs_normalizer
        assert isinstance(normaliser, SymmetricNormalization)
        assert torch.equal(MIRROR(normaliser.mean), normaliser.mean)
        assert float((normaliser.mean - 0.0).abs().max()) > 0.1
    spread = runner.alg.actor.output_std[0]
    assert torch.equal(spread[list(JOINTS.permutation)], spread)
    assert spread.std() > 0.0


def test_a_resumed_run_stays_symmetric(tmp_path: Path, puppet, pattern: PatternNetwork):
    """With physics: two iterations, a checkpoint, a third; the restored networks are the saved ones."""
    options = RunOptions(num_envs=4, device="cpu", max_iterations=2, run_dir=tmp_path / "run")
    train(small_task(), options)
    last = train(small_task(), RunOptions(device="cpu", max_iterations=3, resume=tmp_path / "run"))
    content = checkpoint.read(last)
    runner = lopsided_runner(puppet, pattern)
    runner.restore(content)
    assert asymmetry(runner) < 1e-5
    runner.learn(1)
    assert asymmetry(runner) < 1e-5


@pytest.mark.parametrize("size", [192, 136])
def test_export(size: int, tmp_path: Path):
    """TorchScript and ONNX give the model's actions, with the normaliser inside."""
    import onnx
    from onnx.reference import ReferenceEvaluator

    mirror = mirror_of((*BODY, *PATTERN)[: None if size == 192 else len(BODY)])
    settings = runner_settings(small_task(), mirror, 0)["actor"]
    settings = {name: value for name, value in settings.items() if name != "class_name"}
    observed = TensorDict({"policy": 3.0 + torch.randn(64, size)}, batch_size=[64])
    model = EquivariantModel(observed, {"actor": ["policy"]}, "actor", 28, **settings)
    model.update_normalization(observed)
    model.eval()
    with torch.no_grad():
        wanted = model(observed)
        scripted = torch.jit.script(model.as_jit())
        torch.testing.assert_close(scripted.forward(observed["policy"]), wanted)
        path = tmp_path / "actor.onnx"
        exported = model.as_onnx(verbose=False).eval()
        torch.onnx.export(exported, (torch.zeros(1, size),), str(path), dynamo=False, input_names=["obs"])
    (given,) = ReferenceEvaluator(onnx.load(path)).run(None, {"obs": observed["policy"][:1].numpy()})
    torch.testing.assert_close(torch.from_numpy(given), wanted[:1], atol=1e-5, rtol=1e-4)
