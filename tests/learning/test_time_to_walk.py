"""Time to walk: what is counted, what passes, and when a test is given up."""

import time
from collections.abc import Callable

import pytest
import torch

from aicpg_newton.env.registry import get_task, task_from_dict
from aicpg_newton.env.task import Task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning import time_to_walk as walking
from aicpg_newton.learning.runner import Runner
from aicpg_newton.learning.trial import Trial

CPU = torch.device("cpu")


def small_task() -> Task:
    """The flat task with little learning."""
    task = get_task("flat")
    task.learning.hidden_sizes = (16, 16)
    task.learning.steps_per_iteration = 8
    task.learning.minibatches = 2
    return task


def test_where_the_time_goes(monkeypatch: pytest.MonkeyPatch):
    """Parts add up to the whole, tests are not counted, and a training that never walks is given up."""
    monkeypatch.setattr(walking, "INTERVAL", 128)
    tests = []

    def slow_test(trial: Trial, decide: Callable) -> tuple[tuple[float, ...], float]:
        tests.append(decide)
        time.sleep(0.4)
        return (1.0, 0.9), 20.0

    monkeypatch.setattr(walking, "stays_up", slow_test)
    lines: list[str] = []
    began = time.perf_counter()
    result = walking.time_to_walk(
        small_task(), seed=3, engine="mujoco", num_envs=8, device=CPU, maximum_samples=256, show=lines.append
    )
    assert (result.samples, result.passed, len(tests), len(lines)) == (256, False, 2, 2)
    assert result.seconds < time.perf_counter() - began - 0.8
    parts = (result.physics_seconds, result.environment_seconds, result.learning_seconds)
    assert min(parts) > 0.0
    assert sum(parts) == pytest.approx(result.seconds)
    assert "90% at 1.3 Hz" in lines[-1]
    assert [test.samples for test in result.tests] == [128, 256]


def test_it_ends_with_the_first_test_that_is_passed(monkeypatch: pytest.MonkeyPatch):
    """95 % at both frequencies, 61 of 64, not 60."""
    assert walking.Test(1, 1.0, 1e-3, (61 / 64, 1.0), 20.0).passed
    assert not walking.Test(1, 1.0, 1e-3, (60 / 64, 1.0), 20.0).passed
    monkeypatch.setattr(walking, "INTERVAL", 64)
    shares = iter([(0.5, 1.0), (0.96, 0.96)])
    monkeypatch.setattr(walking, "stays_up", lambda trial, decide: (next(shares), 20.0))
    result = walking.time_to_walk(
        small_task(), seed=0, engine="mujoco", num_envs=8, device=CPU, maximum_samples=10_000, show=lambda line: None
    )
    assert result.passed
    assert result.samples == 128


def test_the_shipped_network_walks_and_the_cpg_alone_does_not(pattern: PatternNetwork):
    """On real physics for 4 s: one passes each time alike, the other is given up within 3 s."""
    trained = checkpoint.read(checkpoint.shipped("flat"))
    task = task_from_dict(trained["task"], "shipped")
    trial = Trial(task, "mujoco", pattern, CPU, robots=64, duration=4.0)
    runner = Runner(trial.environment(), trained["run"])
    runner.take_networks(trained, "actor")
    standing, lasted = walking.stays_up(trial, runner.decide)
    assert lasted == 4.0
    assert min(standing) >= walking.SHARE
    with torch.no_grad():
        for weights in runner.alg.actor.mlp.parameters():
            weights.zero_()
    standing, lasted = walking.stays_up(trial, runner.decide)
    assert min(standing) < walking.SHARE
    assert 0.2 < lasted < 3.0
    assert walking.stays_up(trial, runner.decide) == (standing, lasted)


def test_robots_are_tested_undisturbed(pattern: PatternNetwork):
    """Of a task that pushes and changes f as well: they are told one frequency, and keep it."""
    task = small_task()
    task.pushes.force, task.frequencies.change_interval, task.frequencies.jumps = 200.0, 0.1, 1.0
    environment = Trial(task, "mujoco", pattern, CPU, robots=2, duration=1.0).environment()
    for _ in range(20):
        environment.step(torch.zeros(environment.num_envs, 28))
    assert environment.task.pushes.force == 0.0
    assert environment.commands.frequency.unique().tolist() == pytest.approx(list(walking.FREQUENCIES))
