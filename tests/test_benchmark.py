"""The benchmark measures what it says, and its table can be read."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from aicpg_newton.benchmark import BenchmarkOptions, Rates, benchmark, doubts, table, time_to_walk, walking_table
from aicpg_newton.env.registry import get_task
from aicpg_newton.errors import UserError
from aicpg_newton.learning import time_to_walk as walking
from aicpg_newton.learning.time_to_walk import WalkingTime


def quick(**options: Any) -> BenchmarkOptions:
    """Options for the flat task on the CPU."""
    return BenchmarkOptions(**{"settings": get_task("flat"), "device": "cpu", **options})


def test_rates_of_an_engine(capsys: pytest.CaptureFixture):
    """All rates are positive on both grounds, and no environment is faster than its engine by more than noise."""
    rows = benchmark(
        BenchmarkOptions(
            settings=get_task("flat"), num_envs=(8,), engines=("mujoco",), device="cpu", seconds=0.2, iterations=1
        )
    )
    assert [(row.engine, row.task, row.num_envs) for row in rows] == [("mujoco", "flat", 8), ("mujoco", "uneven", 8)]
    for row in rows:
        assert row.bare is not None and row.learning is not None
        assert min(row.bare, row.engine_alone, row.environment, row.learning, row.build) > 0
        assert row.environment < 1.2 * row.engine_alone
    printed = capsys.readouterr().out
    assert "| mujoco | flat | 8 |" in printed and "| mujoco | uneven | 8 |" in printed


def test_newton_reports_its_buffers():
    """Contacts and constraints were counted, and nothing overflowed."""
    rows = benchmark(
        BenchmarkOptions(
            settings=get_task("flat"), num_envs=(4,), engines=("newton",), device="cpu", seconds=0.1, iterations=0
        )
    )
    for row in rows:
        contacts, constraints, *_, overflows = (float(word.split()[0]) for word in row.buffers.split(", "))
        assert contacts > 0
        assert constraints > 0
        assert overflows == 0
        assert row.learning is None


def test_table_is_worked_out_from_the_rates():
    """Shares by hand: the engine is 75 % of the bare loop, and 40 % of the environment's time is outside it."""
    row = Rates("newton", "flat", 256, 3.0, 2000.0, 1500.0, 900.0, None, 0.02, "-")
    assert (
        table([row]).splitlines()[-1] == "| newton | flat | 256 | 3.0 | 2,000 (75%) | 1,500 | 900 | 40% | - | 2% | - |"
    )


def test_rates_beside_other_work_are_doubted():
    """One disturbed row is enough; on a free machine nothing is said."""
    free = Rates("newton", "flat", 256, 3.0, None, 1500.0, 900.0, 800.0, 0.02, "-")
    assert not doubts([free])
    assert "for up to 85% of the time" in doubts([free, replace(free, waiting=0.85)])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_envs": ()}, "--num-envs"),
        ({"num_envs": (4, 0)}, "--num-envs"),
        ({"seconds": 0.0}, "--seconds"),
        ({"engines": ("bullet",)}, "bullet"),
        ({"tasks": ("moon",)}, "moon"),
        ({"tasks": ()}, "--tasks is empty"),
        ({"seeds": ()}, "--seeds is empty"),
        ({"max_samples": 0}, "--max-samples is 0"),
        ({"json": Path("nowhere/times.json")}, "no folder nowhere"),
        ({"json": Path("times.txt")}, "must end in .json"),
        ({"engines": ("newton",), "learner_device": "cuda:0"}, "goes with --engine mujoco"),
    ],
)
def test_bad_options(changes: dict, message: str):
    """One sentence each, for both ways to measure."""
    for measure in (benchmark, time_to_walk):
        with pytest.raises(UserError, match=message):
            measure(quick(**changes))


def test_time_to_walk_of_some_seeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture):
    """The settings given reach the training, and the file has an object for each seed once that seed is done."""
    path, trained = tmp_path / "times.json", []

    def train(task: Any, *, seed: int, **options: Any) -> WalkingTime:
        written = json.loads(path.read_text()) if path.exists() else []
        assert [each["seed"] for each in written] == [0, 2][: len(trained)]
        trained.append((task.learning.epochs, options["engine"], options["num_envs"]))
        return WalkingTime(seed, True, 100.0 + seed, 1_000_000, 50.0, 10.0, 40.0 + seed, 180.0)

    monkeypatch.setattr(walking, "time_to_walk", train)
    task = get_task("flat")
    settings = replace(task, learning=replace(task.learning, epochs=3))
    options = BenchmarkOptions(time_to_walk=True, seeds=(0, 2), json=path, device="cpu", settings=settings)
    time_to_walk(options)
    assert trained == [(3, "mujoco", 256)] * 2
    written = json.loads(path.read_text())
    wanted = {"seed", "seconds", "samples", "physics_seconds", "environment_seconds", "learning_seconds"}
    assert all(wanted <= set(each) for each in written)
    assert [each["seconds"] for each in written] == [100.0, 102.0]
    assert not list(tmp_path.glob("*.partial"))
    assert "| median | 1,000,000 | 101 |" in capsys.readouterr().out


def test_shares_of_the_walking_time():
    """By hand: half the time in the physics, and 10,000 samples a second."""
    row = walking_table([WalkingTime(1, False, 200.0, 2_000_000, 100.0, 20.0, 80.0)]).splitlines()[2]
    assert row == "| 1 | 2,000,000 | 200 | 100 s (50%) | 20 s (10%) | 80 s (40%) | 10,000 | no |"


def test_settings_can_be_given_on_the_command_line():
    """As in train.py; a wrong one is one sentence and exit status 2."""
    command = [sys.executable, "-m", "aicpg_newton.benchmark", "--time-to-walk", "--learning.epochs", "0"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr.splitlines()[-1].startswith("error: learning.epochs is 0")
