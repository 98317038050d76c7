"""The script that measures memory and buffers."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def call(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run it on the CPU."""
    command = [sys.executable, "scripts/memory.py", "--device", "cpu", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_memory_and_buffers():
    """Sizes are of the right order and never negative; robots have contacts, and none is lost."""
    result = call("--tasks", "flat", "--num-envs", "8", "32", "--buffer-envs", "2", "--buffer-seconds", "0.1")
    assert result.returncode == 0, result.stderr
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in result.stdout.splitlines() if "|" in line]
    sizes = {row[0]: [float(cell) for cell in row[3:7]] for row in rows if row[0] in ("newton", "mujoco")}
    assert 100 < sizes["newton"][0] < 1000 and 1 < sizes["mujoco"][0] < 100
    assert min(min(row) for row in sizes.values()) >= 0.0
    # Four samples a robot, of each at least its observation and six hidden layers before and after ReLU.
    assert 4 * 4 * (192 + 2 * 896) / 1e3 < sizes["newton"][3] < 200
    marks = {row[1]: row[2:] for row in rows if row[0] == "flat"}
    for title in ("trained", "random actions", "lying"):
        mean, most, constraints, overflows = map(float, marks[title])
        assert 0 < mean <= most < 40 and 0 < constraints < 200 and overflows == 0


@pytest.mark.slow
def test_one_size_has_no_slope():
    """It says so in one sentence."""
    result = call("--num-envs", "4")
    assert result.returncode == 2
    assert "give at least two different positive numbers" in result.stderr and "Traceback" not in result.stderr
