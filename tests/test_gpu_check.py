"""The script for the first minutes on a GPU runs to its end, here on a CPU with tiny sizes."""

import io
import json
import os
import subprocess
import tarfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.slow
def test_the_whole_check(tmp_path: Path):
    """Every part leaves its output; captured steps are equal, engines agree, and a training is there."""
    small = {
        "DEVICE": "cpu",
        "SIZES": "4",
        "SECONDS_EACH": "0.1",
        "ITERATIONS": "1",
        "COMPILED_ENVS": "4",
        "LIMIT": "900",
    }
    command = [str(ROOT / "scripts" / "gpu_check.sh"), str(tmp_path / "out")]
    result = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **small})
    assert result.returncode == 0, result.stdout[-3000:]
    assert "Failed" not in result.stdout and "All done" in result.stdout
    assert "plane: largest difference after 60 steps 0\n" in result.stdout
    assert "terrain: root" in result.stdout
    assert [row["task"] for row in json.loads((tmp_path / "out" / "plain.json").read_text())] == ["flat", "uneven"]
    assert [row["task"] for row in json.loads((tmp_path / "out" / "compiled.json").read_text())] == ["flat"]
    for task in ("flat", "robust"):
        assert (tmp_path / "out" / f"run_{task}" / "model_2.pt").is_file()


@pytest.mark.slow
def test_trainings_side_by_side(tmp_path: Path):
    """One as on the GPU and one beside it come home as an archive."""
    short = "--num-envs 4 --max-iterations 3\n"
    trainings = f"first gpu --task flat {short}second cpu --method ppo {short}"
    result = subprocess.run(
        [str(ROOT / "scripts" / "gpu_train.sh"), str(tmp_path / "out"), "900", "0"],
        input=trainings,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "DEVICE": "cpu", "RUNS": str(tmp_path / "runs")},
    )
    assert result.returncode == 0, result.stdout
    parts = sorted((tmp_path / "out").glob("trainings.tar.gz.part-*"))
    with tarfile.open(fileobj=io.BytesIO(b"".join(part.read_bytes() for part in parts))) as archive:
        names = archive.getnames()
    for name in ("first", "second"):
        assert {f"{name}.log", f"{name}/config.yaml", f"{name}/model_2.pt"} <= set(names), result.stdout


def test_a_device_that_is_not_there(tmp_path: Path):
    """It says so and ends with exit status 1."""
    command = [str(ROOT / "scripts" / "gpu_check.sh"), str(tmp_path / "out")]
    result = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "DEVICE": "cuda:7", "PYTHONPATH": ""}
    )
    assert result.returncode == 1
    assert "'cuda:7' is not there" in result.stdout and "Traceback" not in result.stdout
    assert result.stdout.rstrip().endswith("Nothing else can be tried.")
