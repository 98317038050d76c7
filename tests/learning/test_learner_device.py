"""Networks on another device than the physics: tensors cross over where they must, shown by tensors without data."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest
import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch._subclasses.fake_tensor import FakeTensorMode

from aicpg_newton.env.observations import BODY, PATTERN
from aicpg_newton.env.registry import get_task
from aicpg_newton.learning.runner import Runner

OTHER, CPU = torch.device("meta"), torch.device("cpu")
"""Torch's device without memory stands for a GPU: a build of torch for CPUs takes no part of a GPU's name seriously."""


class CpuEnvironment(VecEnv):
    """Takes actions on the CPU and gives back tensors there."""

    def __init__(self) -> None:
        self.task, self.blocks = get_task("flat"), (*BODY, *PATTERN)
        self.num_envs, self.num_actions, self.max_episode_length = 4, 28, 1000
        self.device, self.cfg = CPU, {}
        self.episode_length_buf = torch.zeros(4, dtype=torch.long)
        self.actions: list[torch.device] = []
        self.faults = SimpleNamespace(take=dict)

    def get_observations(self) -> TensorDict:
        """Of the right size."""
        return TensorDict({"policy": torch.zeros(4, 192)}, batch_size=[4], device=CPU)

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict]:
        """Note where the actions are; torch refuses to add tensors of two devices."""
        self.actions.append(actions.device)
        reward = (actions + torch.zeros(4, 28)).sum(dim=1)
        ended = torch.zeros(4, dtype=torch.long)
        return self.get_observations(), reward, ended, {"time_outs": ended.bool(), "log": {}}


def move(module: torch.nn.Module, change: Callable[[torch.Tensor], torch.Tensor]) -> torch.nn.Module:
    """What ``Module.to`` does to parameters and buffers, with new ones: tensors without data cannot be swapped."""
    for part in module.modules():
        for name, value in part.named_parameters(recurse=False):
            part._parameters[name] = torch.nn.Parameter(change(value.detach()), value.requires_grad)
        for name, value in part.named_buffers(recurse=False):
            part._buffers[name] = change(value)
    return module


@pytest.fixture
def no_data(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Tensors on any device without that device: shapes and devices are checked, nothing is computed."""
    monkeypatch.setattr(torch.nn.Module, "_apply", move)
    with FakeTensorMode():
        yield


@pytest.mark.parametrize("network", ["equivariant", "mlp"])
def test_samples_go_to_the_networks_and_actions_to_the_physics(network: str, no_data: None):
    """An iteration of rsl_rl's loop but for the update, whose losses it would read."""
    environment = CpuEnvironment()
    environment.task.learning.network = "mlp" if network == "mlp" else "equivariant"
    runner = Runner(environment, {"seed": 0}, device=OTHER)  # pyright: ignore[reportArgumentType]
    runner.cfg["check_for_nan"] = False
    updates = []
    runner.alg.update = lambda: updates.append(runner.alg.storage.step) or {}
    runner.learn(1)
    assert updates == [environment.task.learning.steps_per_iteration]
    assert set(environment.actions) == {CPU}
    storage = runner.alg.storage
    kept = (storage.observations["policy"], storage.actions, storage.rewards, storage.returns, storage.advantages)
    assert {each.device for each in kept} == {OTHER}
    assert {each.device for each in runner.alg.actor.parameters()} == {OTHER}
    assert {each.device for each in runner.alg.critic.parameters()} == {OTHER}
    assert runner.decide(environment.get_observations()).device == CPU


def test_two_devices_would_be_noticed(no_data: None):
    """The check itself: tensors of two devices that meet are refused here as on a real machine."""
    with pytest.raises(RuntimeError, match="device"):
        torch.add(torch.zeros(4, device=OTHER), torch.zeros(4))
