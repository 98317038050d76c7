"""The command line, and the example that takes what it wrote."""

import re
import subprocess
import sys
from pathlib import Path

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
