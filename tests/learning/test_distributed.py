"""Several processes that train one network, with gloo on the CPU: equal networks, one run folder, clear ends."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from aicpg_newton import launcher
from aicpg_newton.device import cpu_cores, resolve_device
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.registry import get_task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning import checkpoint, distributed
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.policy import Trained, load_policy
from aicpg_newton.learning.runner import Runner, TimeIsUp
from aicpg_newton.learning.training import train

ROOT = Path(__file__).resolve().parent.parent.parent
SCRIPT = Path(__file__).with_name("process.py")


def surroundings(**variables: Any) -> dict[str, str]:
    """This process's environment, with one thread for each process, and these variables."""
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", **{k: str(v) for k, v in variables.items()}}


def start(size: int, *command: object) -> list[subprocess.Popen[str]]:
    """Start a command as a launcher does, in several processes that are to find one another."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    places = [
        surroundings(
            RANK=rank,
            LOCAL_RANK=rank,
            WORLD_SIZE=size,
            LOCAL_WORLD_SIZE=size,
            MASTER_ADDR="127.0.0.1",
            MASTER_PORT=port,
        )
        for rank in range(size)
    ]
    line = [sys.executable, *map(str, command)]
    return [
        subprocess.Popen(line, env=place, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        for place in places
    ]


def finish(processes: list[subprocess.Popen[str]]) -> list[tuple[int, str, str]]:
    """Exit status, stdout and stderr of each, once all have ended."""
    said = [process.communicate(timeout=300) for process in processes]
    return [(process.returncode, *each) for process, each in zip(processes, said, strict=True)]


def wait_for(happened: Callable[[], bool], processes: list[subprocess.Popen[str]]) -> None:
    """Wait for something that the processes do while they run."""
    end = time.monotonic() + 240
    while not happened():
        assert time.monotonic() < end and all(process.poll() is None for process in processes)
        time.sleep(0.2)


def same(one: Any, other: Any) -> bool:
    """Whether nested states are equal to the last bit."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(same, one, other))
    return torch.equal(one, other) if isinstance(one, torch.Tensor) else one == other


def long_training(folder: Path) -> list[object]:
    """A training that does not end by itself."""
    sizes = ("--learning.hidden-sizes", 16, 16, "--learning.steps-per-iteration", 4, "--learning.save-interval", 2)
    return ["train.py", "--num-envs", 4, "--device", "cpu", "--run-dir", folder, "--max-iterations", 10**6, *sizes]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["ai-cpg", "amp"])
def test_two_processes_learn_one_network(method: str, tmp_path: Path, puppet, pattern: PatternNetwork):
    """Bit for bit, normalisers and learning rate too; one folder with one checkpoint of all samples, which plays."""
    ends = finish(start(2, SCRIPT, tmp_path, "train", method))
    assert [status for status, _, _ in ends] == [0, 0], ends
    assert "Done" in ends[0][1] and not ends[1][1]
    first, second = (torch.load(tmp_path / f"{rank}.pt") for rank in range(2))
    for name in ("actor_state_dict", "critic_state_dict", "optimizer_state_dict", "rate"):
        assert same(first[name], second[name]), name
    if method == "amp":
        for name in ("discriminator", "optimizer"):
            assert same(first["motion_prior"][name], second["motion_prior"][name]), name
        assert not same(first["motion_prior"]["replay"], second["motion_prior"]["replay"])
    dealt = sorted(first["frequencies"] + second["frequencies"])
    assert dealt == pytest.approx(get_task("flat").commands(8, "cpu").frequency.tolist())
    trained = Trained.read(tmp_path / "run")
    content = trained.content
    assert (content["samples"], content["run"]["processes"], content["run"]["num_envs"]) == (3 * 8 * 4, 2, 4)
    assert content["algorithm"]["actor_state_dict"]["obs_normalizer.count"] == 3 * 8 * 4
    assert same(content["algorithm"]["actor_state_dict"], first["actor_state_dict"])
    assert len(list((tmp_path / "run").glob("events.*"))) == 1
    environment = Environment(trained.task, puppet(2), pattern)
    actions = load_policy(environment, content)(environment.get_observations()["policy"])
    assert torch.isfinite(actions).all()


def test_an_update_of_two_processes_is_that_of_one_with_all_samples(tmp_path: Path):
    """Gradients, advantages and normalisers are those of the union, of policy, value function and discriminator."""
    ends = finish(start(2, SCRIPT, tmp_path, "update") + start(1, SCRIPT, tmp_path, "update"))
    assert [status for status, _, _ in ends] == [0, 0, 0], ends
    first, second, alone = (torch.load(tmp_path / f"{name}.pt") for name in ("0_of_2", "1_of_2", "0_of_1"))
    for method in ("ai-cpg", "amp"):
        states = [
            [each[method][f"{name}_state_dict"] for each in (first, second, alone)] for name in ("actor", "critic")
        ]
        if method == "amp":
            states.append([each[method]["motion_prior"]["discriminator"] for each in (first, second, alone)])
        for one, other, expected in states:
            assert same(one, other)
            for name, value in expected.items():
                difference = (one[name] - value).abs().max()
                assert torch.allclose(one[name], value, rtol=1e-4, atol=1e-6), (method, name, difference)


@pytest.mark.slow
def test_one_that_is_killed_ends_the_other(tmp_path: Path):
    """Soon, in one sentence, and what has been learned is saved."""
    folder = tmp_path / "run"
    running = start(2, *long_training(folder))
    try:
        wait_for((folder / "model_2.pt").exists, running)
        running[1].kill()
        began = time.monotonic()
        status, said, complained = finish(running[:1])[0]
        assert time.monotonic() - began < 60
    finally:
        for process in running:
            process.kill()
            process.communicate()
    assert status == 2
    assert complained.count("error: another process of this training has ended") == 1
    assert "Traceback" not in complained
    assert "Stopped; continue with" in said
    assert checkpoint.read(folder)["iteration"] >= 3


@pytest.mark.slow
def test_torchrun_that_is_terminated_saves_once(tmp_path: Path):
    """All processes stop at the same iteration; the first one writes it, and one process goes on with it."""
    folder = tmp_path / "run"
    line = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", *map(str, long_training(folder))]
    torchrun = subprocess.Popen(
        [sys.executable, *line], env=surroundings(), cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        wait_for((folder / "model_2.pt").exists, [torchrun])
    finally:
        torchrun.send_signal(signal.SIGTERM)  # not killed: it ends those it has started
        said, complained = torchrun.communicate(timeout=60)
    assert torchrun.returncode != 0
    assert said.count("Stopped; continue with") == 1
    assert "another process" not in complained
    done = checkpoint.read(folder)["iteration"]
    assert done >= 3
    task = Trained.read(folder).task
    last = train(task, RunOptions(resume=folder, device="cpu", max_iterations=done + 1))
    assert checkpoint.read(last)["samples"] == done * 2 * 4 * 4 + 4 * 4


VARIABLES = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Set a launcher's variables; nothing else is left of them."""

    def launch(**variables: str) -> None:
        for name in VARIABLES:
            monkeypatch.delenv(name, raising=False)
        for name, value in variables.items():
            monkeypatch.setenv(name, value)

    return launch


PLACE = {
    "RANK": "5",
    "WORLD_SIZE": "8",
    "LOCAL_RANK": "1",
    "LOCAL_WORLD_SIZE": "4",
    "MASTER_ADDR": "127.0.0.1",
    "MASTER_PORT": "29500",
}


def test_a_process_knows_its_place(launched: Callable[..., None]):
    """All variables, or it is alone; LOCAL_WORLD_SIZE may be left out."""
    launched()
    assert launcher.place() == launcher.Place() and not launcher.incomplete()
    launched(WORLD_SIZE="1")
    assert not launcher.incomplete()
    launched(**PLACE)
    assert launcher.place() == launcher.Place(rank=5, size=8, local_rank=1, local_size=4)
    for changes, message in (({"RANK": "8"}, "RANK=8"), ({"WORLD_SIZE": "two"}, "WORLD_SIZE=two")):
        launched(**{**PLACE, **changes})
        with pytest.raises(ValueError, match=message):
            launcher.place()


def test_processes_share_a_machine(launched: Callable[..., None], monkeypatch: pytest.MonkeyPatch):
    """Each has a GPU of its own and its part of the cores, one at least."""
    launched()
    cores = cpu_cores()
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    launched(**PLACE)
    assert cpu_cores() == max(1, cores // 4)
    assert resolve_device("auto") == resolve_device("cuda") == torch.device("cuda:1")
    with pytest.raises(UserError, match="4 processes run here; give --device cuda"):
        resolve_device("cuda:0")
    launched(**{**PLACE, "LOCAL_RANK": "2"})
    with pytest.raises(UserError, match=r"'cuda:2' is not there \(CUDA devices found: 2\)"):
        resolve_device("auto")


def test_what_cannot_be_several_processes_says_so(
    launched: Callable[..., None], capsys: pytest.CaptureFixture, tmp_path: Path
):
    """In one sentence, with status 2: one variable alone for a training, a launcher for anything else."""
    launched(WORLD_SIZE="2")
    with pytest.raises(UserError, match="WORLD_SIZE is 2, but RANK, LOCAL_RANK, MASTER_ADDR and MASTER_PORT are not"):
        train(get_task("flat"), RunOptions(run_dir=tmp_path / "run"))
    assert not (tmp_path / "run").exists()
    done = []
    run_command(lambda: done.append("alone"))
    assert done == ["alone"]
    for variables, message in ((PLACE, "only train.py is for several"), ({**PLACE, "RANK": "9"}, "RANK=9")):
        launched(**variables)
        with pytest.raises(SystemExit) as ended:
            run_command(lambda: done.append("never"))
        assert ended.value.code == 2
        assert message in capsys.readouterr().err
    assert done == ["alone"]


@pytest.mark.slow
def test_one_refusal_is_told_once(tmp_path: Path):
    """By the first process, whichever has to refuse; nothing is written."""
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine").touch()
    ends = finish(start(2, *long_training(tmp_path / "run")))
    assert [status for status, _, _ in ends] == [2, 2]
    assert "is not empty; choose another folder" in ends[0][2]
    assert "error" not in ends[1][2]
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["mine"]


def test_alone_everything_is_as_it_is(pattern: PatternNetwork):
    """No process is waited for."""
    values = torch.randn(50)
    assert distributed.greatest(3) == 3
    assert torch.equal(distributed.mean(values), values)
    expected = (values - values.mean()) / (values.std() + 1e-8)
    assert torch.allclose(distributed.standardised(values), expected, atol=1e-6)
    assert not distributed.is_loss(RuntimeError("gloo"))


@pytest.mark.parametrize(("reason", "kind"), [(1, TimeIsUp), (2, KeyboardInterrupt)])
def test_all_stop_where_one_has_a_reason(
    reason: int, kind: type[BaseException], puppet, pattern: PatternNetwork, monkeypatch: pytest.MonkeyPatch
):
    """Before the next update: nothing is learned of what was collected since."""
    told = iter((0, reason))
    monkeypatch.setattr(distributed, "greatest", lambda own: next(told))
    task = get_task("flat")
    task.learning.hidden_sizes, task.learning.steps_per_iteration = (16, 16), 4
    runner = Runner(Environment(task, puppet(4), pattern), {"seed": 0})
    with pytest.raises(kind):
        runner.learn(5)
    assert runner.has_learned and runner.current_learning_iteration == 0
    assert runner.alg.get_policy().state_dict()["obs_normalizer.count"] == 4 * 4
