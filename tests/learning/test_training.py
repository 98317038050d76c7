"""A run from settings to checkpoints, with physics, and its exact continuation."""

import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from rsl_rl.algorithms import PPO
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from aicpg_newton.device import torch_threads
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import ImitationTask, Task
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.plan import RunOptions, task_of
from aicpg_newton.learning.ppo import BoundedPPO
from aicpg_newton.learning.runner import Runner
from aicpg_newton.learning.training import train
from aicpg_newton.robot.fingerprint import fingerprint


def small_task(method: str = "ai-cpg") -> Task:
    """The flat task with little learning."""
    task = get_task("flat", method)
    task.learning.hidden_sizes = (32, 32)
    task.learning.steps_per_iteration = 8
    task.learning.minibatches = 2
    task.learning.epochs = 2
    return task


def options(folder: Path | None, **changes) -> RunOptions:
    """Two iterations of four environments."""
    return RunOptions(**{"num_envs": 4, "device": "cpu", "max_iterations": 2, "run_dir": folder, **changes})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run."""
    folder = tmp_path_factory.mktemp("runs") / "first"
    train(small_task(), options(folder))
    return folder


def test_run_folder(run: Path):
    """Checkpoints, the resolved configuration with revision and versions, and a log of every reward term."""
    assert checkpoint.latest(run).name == "model_1.pt"
    config = yaml.safe_load((run / "config.yaml").read_text())
    assert config["task"]["learning"]["hidden_sizes"] == [32, 32]
    frequencies = config["task"]["frequencies"]
    assert (frequencies["minimum"], frequencies["maximum"]) == (0.8, 1.4)
    assert config["run"]["num_envs"] == 4
    assert config["run"]["engine"] == "mujoco"
    assert config["run"]["device"] == config["run"]["learner_device"] == "cpu"
    assert config["humanoid"] == fingerprint()
    assert {"git_revision", "versions", "seed"} <= set(config["run"])
    log = EventAccumulator(str(run)).Reload()
    tags = set(log.Tags()["scalars"])
    assert {"Loss/value", "Perf/total_fps", "Speed/lowest_third_of_f"} <= tags


def test_checkpoint_rebuilds_everything(run: Path, pattern: PatternNetwork):
    """Task, pattern network and networks come from the one file."""
    content = checkpoint.read(run)
    assert content["iteration"] == 2
    assert content["samples"] == 2 * 4 * 8
    assert content["task"]["learning"]["steps_per_iteration"] == 8
    stored = PatternNetwork.from_content(content["pattern"], "checkpoint")
    window = torch.rand(3, 50)
    assert torch.equal(stored(window), pattern(window))


def test_restore_continues_exactly(run: Path, puppet, pattern: PatternNetwork):
    """Networks, normalisers, optimiser moments, learning rate, iteration and samples are those of the checkpoint."""
    content = checkpoint.read(run)
    content["algorithm"]["optimizer_state_dict"]["param_groups"][0]["lr"] = 1.25e-4
    environment = Environment(small_task(), puppet(4), pattern)
    runner = Runner(environment, content["run"])
    runner.restore(content)
    saved, restored = content["algorithm"], runner.alg.save()
    for name in ("actor_state_dict", "critic_state_dict"):
        assert saved[name].keys() == restored[name].keys()
        assert all(torch.equal(value, restored[name][key]) for key, value in saved[name].items())
        assert saved[name]["obs_normalizer.count"] == 2 * 4 * 8
    moments = saved["optimizer_state_dict"]["state"]
    assert moments
    for index, state in moments.items():
        assert torch.equal(state["exp_avg"], restored["optimizer_state_dict"]["state"][index]["exp_avg"])
    assert runner.alg.learning_rate == 1.25e-4
    assert runner.current_learning_iteration == 2
    assert runner.logger.tot_timesteps == 64


def test_resume_goes_on_counting(run: Path, tmp_path: Path):
    """A resumed run does the missing iterations, starts from the checkpoint's samples and stays the run it was."""
    begun = train(small_task(), options(tmp_path / "first", start_from=run, seed=7, max_iterations=1))
    last = train(small_task(), options(tmp_path / "second", resume=begun, max_iterations=2))
    kept = checkpoint.read(last)["run"]
    assert kept["seed"] == 7 and kept["start_from"] == f"{run.name} (64 samples)"
    last = train(small_task(), options(tmp_path / "third", resume=run, max_iterations=3))
    assert last.name == "model_2.pt"
    content = checkpoint.read(last)
    assert content["iteration"] == 3
    assert content["samples"] == 3 * 4 * 8


def test_resume_in_the_same_folder_keeps_what_is_there(run: Path, tmp_path: Path):
    """The first configuration stays, a second one tells what changed, and later checkpoints are never overwritten."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    first = (folder / "config.yaml").read_text()
    with pytest.raises(UserError, match=r"later checkpoints up to model_1\.pt"):
        train(small_task(), options(folder, resume=folder / "model_0.pt", run_dir=None))
    task = small_task()
    task.learning.discount = 0.95
    train(task, options(folder, resume=folder / "model_1.pt", run_dir=None, num_envs=None, max_iterations=3))
    assert (folder / "config.yaml").read_text() == first
    second = yaml.safe_load((folder / "config_from_iteration_2.yaml").read_text())
    assert second["task"]["learning"]["discount"] == 0.95
    assert second["run"]["num_envs"] == 4
    assert {path.name for path in folder.glob("model_*.pt")} == {"model_0.pt", "model_1.pt", "model_2.pt"}


@pytest.mark.parametrize("engine", ["mujoco", "newton"])
@pytest.mark.parametrize("method", ["ppo", "amp"])
def test_baselines_train_on_both_engines(tmp_path: Path, method: str, engine: str):
    """Networks change, the checkpoint says what it is, and the discriminator's losses are logged for AMP alone."""
    task = small_task(method)
    if isinstance(task, ImitationTask):
        task.imitation.discriminator_hidden_sizes = (16, 8)
        task.imitation.discriminator_batch = 8
    task.learning.save_interval = 1
    last = train(task, options(tmp_path / "run", engine=engine))
    assert task_of(last) == task.for_environments(4)
    first, second = (checkpoint.read(path)["algorithm"]["actor_state_dict"] for path in checkpoint.all_of(last.parent))
    assert any(not torch.equal(first[name], second[name]) for name in first if name.startswith("mlp."))
    log = EventAccumulator(str(tmp_path / "run")).Reload()
    tags = set(log.Tags()["scalars"])
    assert ("Loss/discriminator" in tags) == (method == "amp")
    resumed = train(task, options(None, engine=engine, resume=tmp_path / "run", max_iterations=3))
    assert checkpoint.read(resumed)["iteration"] == 3


def test_a_new_run_may_begin_with_trained_networks(run: Path, tmp_path: Path):
    """Networks and normalisers come from the checkpoint, with or without its optimiser; the rest is new."""
    shipped = tmp_path / "shipped.pt"
    checkpoint.save(checkpoint.without_optimiser(checkpoint.read(run)), shipped)
    task = small_task()
    task.learning.learning_rate_schedule = "fixed"
    task.learning.learning_rate = task.learning.minimum_learning_rate = 1e-12  # changes next to nothing
    task.learning.minibatches = task.learning.epochs = 1
    last = train(task, options(tmp_path / "second", start_from=shipped, max_iterations=1))
    before, after = (checkpoint.read(path)["algorithm"] for path in (shipped, last))
    for name in ("actor_state_dict", "critic_state_dict"):
        assert before[name].keys() == after[name].keys()
        assert all(
            torch.allclose(before[name][key], after[name][key], atol=1e-6) for key in before[name] if "mlp" in key
        )
        assert after[name]["obs_normalizer.count"] == before[name]["obs_normalizer.count"] + 32
    content = checkpoint.read(last)
    assert (content["iteration"], content["samples"]) == (1, 32)
    assert "shipped.pt (64 samples)" in content["run"]["start_from"]
    with pytest.raises(UserError, match="one of them"):
        train(task, options(tmp_path / "third", start_from=shipped, resume=run))


def test_physics_gets_the_cores_and_learning_all_threads(pattern: PatternNetwork, monkeypatch: pytest.MonkeyPatch):
    """While samples are collected torch has one thread; while the networks are updated it has all it had before."""
    seen = {}

    def spy(name: str, call: Callable) -> Callable:
        def spied(*args: Any) -> Any:
            seen.setdefault(name, set()).add(torch.get_num_threads())
            return call(*args)

        return spied

    monkeypatch.setattr(Environment, "step", spy("step", Environment.step))
    monkeypatch.setattr(PPO, "update", spy("update", PPO.update))
    with torch_threads(3):
        task = small_task()
        Runner(Environment(task, engine_for(task, "mujoco", 4, torch.device("cpu")), pattern), {"seed": 0}).learn(2)
        assert torch.get_num_threads() == 3
    assert seen == {"step": {1}, "update": {3}}


def test_a_checkpoint_of_the_first_version_is_resumed_as_it_was(tmp_path: Path):
    """Its settings had other names and fewer; it goes on with ordinary networks and rsl_rl's schedule."""
    task = small_task()
    task.learning.network, task.learning.learning_rate_schedule = "mlp", "minibatch"
    task.learning.minimum_learning_rate, task.learning.maximum_learning_rate = 1e-5, 1e-2
    train(task, options(tmp_path / "run"))
    content = checkpoint.read(tmp_path / "run")
    learning = content["task"]["learning"]
    for name in ("network", "critic_hidden_sizes", "minimum_learning_rate", "maximum_learning_rate"):
        del learning[name]
    del learning["learning_rate_schedule"]
    learning["adaptive_learning_rate"] = True
    old = tmp_path / "old.pt"
    checkpoint.save(content, old)
    assert task_of(old) == task
    last = train(task_of(old), options(tmp_path / "resumed", resume=old, max_iterations=3))
    assert checkpoint.read(last)["iteration"] == 3


def test_a_run_stops_when_its_time_is_over(tmp_path: Path):
    """At the next checkpoint, from which it goes on; nothing is lost."""
    task = small_task()
    task.learning.save_interval = 1
    last = train(task, options(tmp_path / "run", max_iterations=50, max_minutes=1e-6))
    assert checkpoint.read(last)["iteration"] == 1
    assert last == train(task, options(None, resume=tmp_path / "run", max_iterations=2)).with_name("model_0.pt")
    assert checkpoint.read(tmp_path / "run")["iteration"] == 2


def test_nothing_left_to_do(run: Path):
    """Resuming a finished run is refused with the number to raise."""
    with pytest.raises(UserError, match="2 iterations already"):
        train(small_task(), options(run, resume=run, run_dir=None))


def test_a_folder_in_use_is_not_written_into(run: Path):
    """Another run's folder stays as it is."""
    before = sorted(path.name for path in run.iterdir())
    with pytest.raises(UserError, match="not empty"):
        train(small_task(), options(run))
    assert sorted(path.name for path in run.iterdir()) == before


def test_other_layer_sizes_cannot_resume(run: Path, tmp_path: Path):
    """The message names the setting."""
    task = small_task()
    task.learning.hidden_sizes = (16, 16)
    with pytest.raises(UserError, match=r"--learning\.hidden-sizes 32 32"):
        train(task, options(tmp_path / "other", resume=run, max_iterations=3))


@pytest.mark.slow
def test_learning_lengthens_episodes(tmp_path: Path):
    """A few minutes of training on the CPU keep the humanoid on its feet for longer than the CPG alone."""
    task = get_task("flat")
    task.learning.hidden_sizes = (128, 64)
    train(task, RunOptions(num_envs=256, device="cpu", max_iterations=150, run_dir=tmp_path / "run"))
    log = EventAccumulator(str(tmp_path / "run")).Reload()
    lengths = [event.value for event in log.Scalars("Train/mean_episode_length")]
    rewards = [event.value for event in log.Scalars("Train/mean_reward")]
    assert sum(lengths[-5:]) > 1.15 * sum(lengths[2:7])
    assert sum(rewards[-5:]) > 1.15 * sum(rewards[2:7])


def test_networks_that_see_something_else_are_refused(run: Path, tmp_path: Path):
    """As many numbers in another order would go unnoticed; both layouts are named."""
    content = checkpoint.read(run)
    blocks = content["observations"]
    assert sum(size for _, size in blocks) == 192
    place = [name for name, _ in blocks].index("pitch")
    blocks[place], blocks[place + 1] = blocks[place + 1], blocks[place]
    swapped = tmp_path / "swapped.pt"
    checkpoint.save(content, swapped)
    with pytest.raises(UserError, match=r"see other observations: the checkpoint's 192 numbers, in another order"):
        train(small_task(), options(tmp_path / "second", start_from=swapped))
    with pytest.raises(UserError, match="see other observations"):
        train(small_task(), options(tmp_path / "third", resume=swapped, max_iterations=3))


def test_a_resumed_run_obeys_new_settings_or_refuses_them(run: Path, tmp_path: Path):
    """Learning rate and exploration are taken, and what was used is written down; seed and pattern cannot be."""
    task = small_task()
    task.learning.learning_rate_schedule = "fixed"
    task.learning.learning_rate, task.learning.initial_std = 7e-4, 0.2
    task.learning.epochs = task.learning.minibatches = 1
    last = train(task, options(tmp_path / "second", resume=run, max_iterations=3))
    content = checkpoint.read(last)
    algorithm = content["algorithm"]
    assert algorithm["optimizer_state_dict"]["param_groups"][0]["lr"] == 7e-4
    spread = algorithm["actor_state_dict"]["distribution.log_std_param"].exp()
    assert torch.allclose(spread, torch.full((28,), 0.2), rtol=0.02)
    assert content["task"]["learning"]["learning_rate"] == 7e-4
    for changes, message in (
        ({"seed": 77}, "--seed is 77, but .* is a run of seed 0"),
        ({"pattern": tmp_path / "other.pt"}, "--pattern .* goes with a new run"),
    ):
        with pytest.raises(UserError, match=message):
            train(small_task(), options(tmp_path / "third", resume=run, max_iterations=3, **changes))
    train(small_task(), options(tmp_path / "fourth", resume=run, max_iterations=3, seed=0))
    assert not (tmp_path / "third").exists()


def test_a_resumed_run_goes_on_with_its_own_learning_rate(run: Path, tmp_path: Path):
    """The adapted one, where nothing else is asked for; it is shown in the log."""
    content = checkpoint.read(run)
    content["algorithm"]["optimizer_state_dict"]["param_groups"][0]["lr"] = 3.21e-4
    changed = tmp_path / "changed.pt"
    checkpoint.save(content, changed)
    train(small_task(), options(tmp_path / "second", resume=changed, max_iterations=3))
    log = EventAccumulator(str(tmp_path / "second")).Reload()
    assert log.Scalars("Learning/rate")[0].value == pytest.approx(3.21e-4)


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_signals_save(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """What a cluster sends before it kills: the iterations done are saved, and the way to go on is told."""
    done = []

    def update(self):
        done.append(1)
        if len(done) == 4:
            os.kill(os.getpid(), getattr(signal, name))
        return PPO.update(self)

    monkeypatch.setattr(BoundedPPO, "update", lambda self: {**update(self), "kl": 0.0})
    before = signal.getsignal(getattr(signal, name))
    with pytest.raises(KeyboardInterrupt):
        train(small_task(), options(tmp_path / "run", max_iterations=100))
    assert checkpoint.read(tmp_path / "run")["iteration"] >= 3
    assert signal.getsignal(getattr(signal, name)) == before
