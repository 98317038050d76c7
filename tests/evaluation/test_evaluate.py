"""Evaluating from end to end: files, their agreement, seeds, run folders and clear words about bad input."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aicpg_newton import evaluate as command_line
from aicpg_newton import places
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import ReflexTask
from aicpg_newton.errors import UserError
from aicpg_newton.evaluate import EvaluateOptions, main
from aicpg_newton.evaluation import results
from aicpg_newton.evaluation import run as running
from aicpg_newton.evaluation.controllers import cpg_alone, trained
from aicpg_newton.evaluation.protocols import PROTOCOLS
from aicpg_newton.evaluation.run import Laboratory, evaluate
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.training import train

ROOT = Path(__file__).resolve().parents[2]


def short(name: str) -> object:
    """A protocol cut to 2.5 s and three frequencies."""
    protocol = PROTOCOLS[name]
    frequencies = protocol.frequencies[:: max(1, len(protocol.frequencies) // 2)]
    return replace(protocol, duration=2.5, frequencies=frequencies, commanded_speeds=protocol.commanded_speeds // 3)


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """All protocols cut short, wherever they are looked up."""
    protocols = {name: short(name) for name in PROTOCOLS}
    monkeypatch.setattr(command_line, "PROTOCOLS", protocols)
    monkeypatch.setattr(running, "SWEEP", protocols["sweep"])


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two iterations with every checkpoint kept."""
    task = get_task("flat")
    task.learning.hidden_sizes = (16,)
    task.learning.save_interval = 1
    folder = tmp_path_factory.mktemp("runs") / "run"
    train(task, RunOptions(num_envs=4, device="cpu", max_iterations=2, seed=5, run_dir=folder))
    return folder


@pytest.mark.usefixtures("brief")
def test_the_cpg_alone_with_all_protocols(tmp_path: Path, capsys: pytest.CaptureFixture):
    """Every protocol leaves a CSV, a JSON and figures; each empty cell has a reason; figures can be redrawn."""
    out = tmp_path / "results"
    main(EvaluateOptions(agent="zero", num_envs=6, device="cpu", seed=2, out=out))
    assert not (out / "terrain.csv").exists() and not (out / "training.csv").exists()
    for name in ("sweep", "disturbance", "transition", "slowing", "up_and_down", "speed"):
        rows, content = results.read_table(out, name), results.read_description(out, name)
        assert rows and {row["method"] for row in rows} == {"CPG alone"}
        for row in rows:
            assert row["reason"] or all(value == value for value in row.values())
            assert row.get("condition", "") == ""
        assert content["engine"] == "mujoco" and content["device"] == "cpu" and content["seed"] == 2
        assert all(entry["environments"] == 6 for entry in content["results"])
        assert {"torch", "newton", "python"} <= set(content["versions"])
    sweep = results.read_table(out, "sweep")
    assert [row["frequency_hz"] for row in sweep] == pytest.approx([0.7, 1.05, 1.4])
    assert all(row["falls_per_minute"] > 0 and row["environments"] == 2 for row in sweep)
    assert all(row["survived_low"] == 0.0 and 0.5 < row["survived_high"] < 1.0 for row in sweep)
    drawn = {path.name: path.read_bytes() for path in out.glob("*.png")}
    assert "figure_3.png" in drawn and "figure_4_cpg_alone.png" in drawn and "Figure:" in capsys.readouterr().out
    main(EvaluateOptions(redraw=(out,), out=tmp_path / "again"))
    assert {path.name: path.read_bytes() for path in (tmp_path / "again").glob("*.png")} == drawn
    with pytest.raises(UserError, match="would be overwritten"):
        main(EvaluateOptions(agent="zero", num_envs=6, device="cpu", protocol="transition", seed=2, out=out))


@pytest.mark.usefixtures("brief")
def test_a_run_folder_and_another_seed(run_folder: Path, tmp_path: Path):
    """The sweep takes the last checkpoint, the disturbance the last ones; a checkpoint's seed is kept."""
    content = torch.load(run_folder / "model_1.pt", weights_only=True)
    content["run"]["seed"] = 6
    torch.save(content, tmp_path / "other.pt")
    options = {
        "checkpoint": (run_folder, tmp_path / "other.pt"),
        "num_envs": 3,
        "device": "cpu",
        "out": tmp_path / "out",
    }
    main(EvaluateOptions(protocol="sweep", **options))
    assert {(row["method"], row["seed"]) for row in results.read_table(tmp_path / "out", "sweep")} == {
        ("AI-CPG", 5.0),
        ("AI-CPG", 6.0),
    }
    main(EvaluateOptions(protocol="disturbance", **options))
    rows = results.read_table(tmp_path / "out", "disturbance")
    iterations = {row["iteration"] for row in rows if row["seed"] == 5.0}
    assert len(iterations) == len(list(run_folder.glob("model_*.pt"))) >= 2
    assert len(rows) == 3 * (len(iterations) + 1)
    controllers = json.loads((tmp_path / "out" / "sweep.json").read_text())["controllers"]
    assert len(controllers[0]["checkpoints"][0]["sha256"]) == 64 and controllers[0]["task"] == "flat"


def test_a_checkpoint_may_be_tested_on_another_task(run_folder: Path):
    """The task's own ground and falls, the checkpoint's reflex and networks."""
    task = get_task("flat")
    assert isinstance(task, ReflexTask)
    task.name, task.termination.maximum_tilt, task.reflex.torque_share = "hills", 50.0, 0.9
    controller = trained(run_folder, task)
    assert isinstance(controller.task, ReflexTask)
    assert controller.task.name == "hills" and controller.task.termination.maximum_tilt == 50.0
    assert controller.task.reflex.torque_share == 0.4 and controller.task.learning.hidden_sizes == (16,)


@pytest.mark.parametrize(("rate", "found"), [(None, 240), (120, 120), (480, 480)])
def test_the_rate_of_the_physics(rate: int | None, found: int, tmp_path: Path):
    """240 Hz, or what is asked for; a network trained at more is tested at more."""
    laboratory = Laboratory(6, device="cpu", physics_rate=rate)
    evaluate([short("sweep")], [cpg_alone(get_task("flat"), 0)], laboratory, tmp_path / "out")  # type: ignore[list-item]
    assert results.read_description(tmp_path / "out", "sweep")["physics_rate_hz"] == [found]
    task = get_task("flat")
    task.physics.substeps = 16
    assert task.undisturbed().physics.substeps == 16


def test_the_same_seed_gives_the_same_numbers(tmp_path: Path):
    """Two evaluations with one seed agree to the last digit, another seed does not."""
    texts = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        laboratory = Laboratory(12, device="cpu", seed=seed)
        evaluate([short("sweep")], [cpg_alone(get_task("flat"), 0)], laboratory, tmp_path / name)  # type: ignore[list-item]
        texts.append((tmp_path / name / "sweep.csv").read_text())
    assert texts[0] == texts[1] != texts[2]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"checkpoint": (Path("nowhere.pt"),)}, "no checkpoint at nowhere.pt"),
        ({"task": "moon", "agent": "zero"}, "unknown task 'moon'"),
        ({"agent": "zero", "num_envs": 14}, "--num-envs is 14, but the sweep protocol has 15"),
        ({"agent": "zero", "num_envs": 0}, "--num-envs is 0"),
        ({"agent": "zero", "physics_rate": 60}, "--physics-rate is 60"),
        ({"agent": "zero", "physics_rate": 250}, "--physics-rate is 250; give a multiple of 120"),
        ({"agent": "zero", "engine": "bullet"}, "bullet"),
        ({"agent": "zero", "checkpoint": (Path("model_1.pt"),)}, "leave --checkpoint out"),
        ({"redraw": (Path("nowhere"),), "device": "auto"}, "no results in nowhere"),
        ({"redraw": (Path("nowhere"),), "checkpoint": (Path("model_1.pt"),)}, "leave --checkpoint out"),
        ({"redraw": (Path("nowhere"),), "device": "auto", "terrain_seed": (7,)}, "leave --terrain-seed out"),
        ({"agent": "zero", "terrain_seed": (7,)}, "the ground is a plane; leave --terrain-seed out"),
        ({"agent": "zero", "protocol": "terrain"}, "the terrain protocol needs uneven ground; give --task uneven"),
        (
            {"agent": "zero", "protocol": "training"},
            "CPG alone, seed 0 has no more than one; give --checkpoint its run",
        ),
        ({"agent": "zero", "task": "uneven", "terrain_seed": (7, 8, 7)}, "give each seed once"),
        ({"agent": "zero", "task": "uneven", "terrain_seed": (-1,)}, "--terrain-seed is -1"),
    ],
)
def test_bad_options(changes: dict, message: str, tmp_path: Path):
    """One sentence each, and nothing is left behind but a folder."""
    out = tmp_path / "out"
    with pytest.raises(UserError, match=message):
        main(EvaluateOptions(**{"device": "cpu", "out": out, **changes}))
    assert not out.exists() or not list(out.iterdir())


def test_no_shipped_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Without one, the user is told what to give."""
    monkeypatch.setattr(places, "ASSETS", tmp_path)
    with pytest.raises(UserError, match="no trained policy ships for task 'flat'; train one and give --checkpoint"):
        main(EvaluateOptions(device="cpu", out=tmp_path / "out"))


def test_one_checkpoint_for_each_seed(run_folder: Path, tmp_path: Path):
    """Two of the same training cannot be told apart in the table."""
    files = (run_folder / "model_0.pt", run_folder / "model_1.pt")
    with pytest.raises(UserError, match="two checkpoints are of AI-CPG, seed 5"):
        main(EvaluateOptions(device="cpu", checkpoint=files, out=tmp_path / "out"))


def test_exit_status(tmp_path: Path):
    """Bad input on the command line: status 2, one line, no traceback."""
    command = [
        sys.executable,
        "-m",
        "aicpg_newton.evaluate",
        "--checkpoint",
        "nowhere.pt",
        "--out",
        str(tmp_path / "out"),
    ]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 2 and "error: no checkpoint at nowhere.pt" in result.stderr
    assert "Traceback" not in result.stderr and not (tmp_path / "out").exists()
