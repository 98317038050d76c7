"""The script for the first minutes on a GPU runs to its end, here on a CPU with tiny sizes."""

import json
import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.slow
def test_the_whole_check(tmp_path: Path):
    """Every part leaves its output; captured steps are equal, engines agree, and a training is there."""
    small = {"DEVICE": "cpu", "SIZES": "4", "SECONDS_EACH": "0.1", "ITERATIONS": "1", "PROFILE_ENVS": "4"}
    small |= {"TRAIN_ENVS": "4", "TRAIN_MINUTES": "0.01"}
    command = [str(ROOT / "scripts" / "gpu_check.sh"), str(tmp_path / "out")]
    result = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **small})
    assert result.returncode == 0, result.stdout[-3000:]
    assert "FAILED" not in result.stdout and "All done" in result.stdout
    assert "plane: largest difference after 60 steps 0\n" in result.stdout
    assert "terrain: root" in result.stdout
    assert [row["task"] for row in json.loads((tmp_path / "out" / "benchmark.json").read_text())] == ["flat", "uneven"]
    assert (tmp_path / "out" / "first_iteration" / "model_0.pt").is_file()
    assert (tmp_path / "out" / "training" / "config.yaml").is_file()


def test_a_device_that_is_not_there(tmp_path: Path):
    """It says so and ends with exit status 1."""
    command = [str(ROOT / "scripts" / "gpu_check.sh"), str(tmp_path / "out")]
    result = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "DEVICE": "cuda:7", "PYTHONPATH": ""}
    )
    assert result.returncode == 1
    assert "'cuda:7' is not there" in result.stdout and "Traceback" not in result.stdout
    assert result.stdout.rstrip().endswith("Nothing else can be tried.")
