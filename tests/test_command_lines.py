"""train.py and play.py as a user calls them: exit status 2 and one sentence for bad input, no traceback."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

SHIPPED = "assets/policies/flat.pt"


def call(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a script of the repository's root."""
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train.py", "--task", "moon"], "unknown task 'moon'"),
        (["train.py", "--task=flat", "--num-envs", "0"], "--num-envs is 0"),
        (["train.py", "--resume", "nowhere"], "no checkpoint at nowhere"),
        (["train.py", "--resume", SHIPPED, "--task", "uneven"], "--task is uneven, but"),
        (["train.py", "--resume", SHIPPED, "--method", "ppo"], "--method is ppo, but"),
        (["train.py", "--physics.substeps", "3"], "physics.substeps is 3"),
        (["train.py", "--ground.seed", "4"], "ground.seed was changed, but does nothing: the ground is a plane"),
        (["train.py", "--max-minutes", "nan"], "--max-minutes is nan; give a positive number"),
        (["train.py", "--rewards.upright.weight", "nan"], "rewards.upright.weight is nan"),
        (
            ["train.py", "--rewards.pattern-tracking.reading", "mean"],
            "reading is 'mean'; choose one of sum_of_magnitudes",
        ),
        (["play.py", "--checkpoint", "nowhere.pt"], "no checkpoint at nowhere.pt"),
        (["play.py", "--task", "moon"], "unknown task 'moon'"),
        (["play.py", "--terrain-seed", "3"], "the ground of task 'flat' is a plane"),
        (["play.py", "--agent", "zero", "--task", "uneven", "--terrain-seed", "-1"], "--terrain-seed is -1"),
    ],
)
def test_bad_input(arguments: list[str], message: str):
    """The sentence goes to stderr."""
    result = call(*arguments)
    assert result.returncode == 2
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert len([line for line in result.stderr.splitlines() if line.startswith("error:")]) == 1


def test_cuda_without_cuda():
    """Asking for a GPU that is not there."""
    result = call("train.py", "--device", "cuda:7")
    assert result.returncode == 2
    assert "'cuda:7' is not there" in result.stderr


def test_help_lists_the_settings_of_the_task():
    """Every setting can be changed from the command line, and its docstring is its help."""
    result = call("train.py", "--help")
    assert result.returncode == 0
    for option in ("--task", "--num-envs", "--device", "--max-iterations", "--seed", "--run-dir", "--resume"):
        assert option in result.stdout
    for setting in ("--rewards.pattern-tracking.bound", "--frequencies.minimum", "--learning.hidden-sizes"):
        assert setting in result.stdout
    assert "Highest f [Hz]" in result.stdout
    assert "--target-speed" not in result.stdout.split("ground options")[1]


def test_a_term_that_the_method_does_not_have_is_refused():
    """It would do nothing."""
    result = call("train.py", "--method", "ppo", "--rewards.pattern-tracking.weight", "2")
    assert result.returncode == 2
    assert "--rewards.pattern-tracking.weight" in result.stderr and "Traceback" not in result.stderr
