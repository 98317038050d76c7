"""The command line, and the example that takes what it wrote."""

# MuJoCo's extension module has no type stubs.
# pyright: reportAttributeAccessIssue=false
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from aicpg_newton.errors import UserError
from aicpg_newton.evaluation.results import read_table
from aicpg_newton.export.__main__ import ExportOptions, export

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "stand_alone.py"
BASELINE = ROOT / "assets" / "policies" / "flat_ppo_1.5.pt"


@pytest.mark.parametrize(
    ("path", "message"),
    [("nowhere.pt", "no checkpoint at nowhere.pt"), (str(BASELINE), "trained as PPO")],
)
def test_nothing_is_written_for_a_checkpoint_that_does_not_do(tmp_path: Path, path: str, message: str):
    """One sentence, and no folder is made."""
    with pytest.raises(UserError, match=message):
        export(ExportOptions(checkpoint=Path(path), out=tmp_path / "new"))
    assert not (tmp_path / "new").exists()


def test_nothing_to_do():
    """Where to is not said."""
    with pytest.raises(UserError, match="nothing to do; give --out DIR"):
        export(ExportOptions())


def test_a_folder_that_cannot_be_made(tmp_path: Path):
    """As a file has its name."""
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"cannot make the folder .*/file \(File exists\)"):
        export(ExportOptions(out=tmp_path / "file"))


def test_the_example_is_short_and_needs_nothing_of_this_package():
    """Under 80 lines."""
    text = EXAMPLE.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 80
    assert set(re.findall(r"(?m)^(?:import|from) (\w+)", text)) == {
        "sys",
        "collections",
        "mujoco",
        "numpy",
        "onnxruntime",
    }


def test_the_example_walks_and_runs(exported: Path, tmp_path: Path):
    """20 s of each without a fall, as fast as the shipped network's own evaluation says."""
    result = subprocess.run(
        [sys.executable, str(EXAMPLE), str(exported)], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    speeds = [float(speed) for speed in re.findall(r"Hz: ([\d.]+) m/s, no fall", result.stdout)]
    sweep = read_table(ROOT / "assets" / "policies" / "robust_evaluation", "sweep")
    said = [row["speed_mps"] for row in sweep if row["frequency_hz"] in (0.9, 1.3)]
    assert speeds == pytest.approx(said, rel=0.05)


def test_the_example_costs_what_the_evaluation_says(
    exported: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Cost of transport in stock MuJoCo, power integrated at every physics step, within 3 % of the committed sweep."""
    spec = importlib.util.spec_from_file_location("stand_alone", EXAMPLE)
    assert spec is not None and spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    step, work = mujoco.mj_step, [0.0]

    def measured(model, data) -> None:
        before = data.qvel[6:].copy()
        step(model, data)
        power = data.sensordata[24:52] * 0.5 * (before + data.qvel[6:])
        work[0] += float(np.abs(power).sum()) * model.opt.timestep

    monkeypatch.setattr(mujoco, "mj_step", measured)
    sweep = read_table(ROOT / "assets" / "policies" / "robust_evaluation", "sweep")
    for start, frequency in (("walk", 0.9), ("run", 1.3)):
        robot = example.Robot(str(exported), start)
        weight = robot.model.body_subtreemass[0] * 9.81
        list(example.walk_and_run(robot, (frequency,), 3.0))
        before, work[0] = robot.data.subtree_com[0, 0], 0.0
        list(example.walk_and_run(robot, (frequency,), 12.0))
        cost = work[0] / (weight * (robot.data.subtree_com[0, 0] - before))
        (said,) = (row["cost_of_transport"] for row in sweep if row["frequency_hz"] == frequency)
        assert cost == pytest.approx(said, rel=0.03)
    capsys.readouterr()
