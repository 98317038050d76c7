"""Commands as a user calls them: exit status 2 and one sentence for bad input, no traceback, and no wait for it.

What takes seconds to load is loaded once the options have been found good.
"""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

SHIPPED = "assets/policies/flat.pt"


SLOW = {"newton", "warp", "rsl_rl", "tensordict", "tensorboard"}
"""Packages that take most of the time until a simulation begins."""


def call(*arguments: str) -> tuple[int, str, str, set[str]]:
    """Run a script of the repository's root: exit status, stdout, stderr, and the slow packages that it loaded."""
    command = [sys.executable, "-X", "importtime", *arguments]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    lines = result.stderr.splitlines()
    imports = [line for line in lines if line.startswith("import time:")]
    said = "\n".join(line for line in lines if not line.startswith("import time:"))
    return result.returncode, result.stdout, said, SLOW & {line.rsplit("|", 1)[1].strip() for line in imports}


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
        (["train.py", "--device", "cuda:7"], "'cuda:7' is not there"),
        (["-m", "aicpg_newton.evaluate", "--out", "nowhere", "--checkpoint", "nowhere.pt"], "no checkpoint at nowhere"),
        (["-m", "aicpg_newton.compare", "--out", "nowhere", "--methods", "dance"], "dance"),
        (["-m", "aicpg_newton.benchmark", "--device", "cuda:7"], "'cuda:7' is not there"),
        (["-m", "aicpg_newton.benchmark", "--time-to-walk", "--device", "cuda:7"], "'cuda:7' is not there"),
        (["-m", "aicpg_newton.publish", "--checkpoint", "nowhere.pt", "--replace"], "no checkpoint at nowhere.pt"),
        (["-m", "aicpg_newton.export", "--checkpoint", "nowhere.pt"], "nothing to do; give --out DIR"),
    ],
)
def test_bad_input(arguments: list[str], message: str):
    """The sentence goes to stderr."""
    status, _, said, loaded = call(*arguments)
    assert (status, loaded) == (2, set())
    assert message in said
    assert "Traceback" not in said
    assert len([line for line in said.splitlines() if line.startswith("error:")]) == 1


def test_help_lists_the_settings_of_the_task():
    """Every setting can be changed from the command line, and its docstring is its help."""
    status, out, _, loaded = call("train.py", "--help")
    assert (status, loaded) == (0, set())
    for option in ("--task", "--num-envs", "--device", "--max-iterations", "--seed", "--run-dir", "--resume"):
        assert option in out
    for setting in ("--rewards.pattern-tracking.bound", "--frequencies.minimum", "--learning.hidden-sizes"):
        assert setting in out
    assert "Highest f [Hz]" in out
    assert "--target-speed" not in out.split("ground options")[1]


def test_a_term_that_the_method_does_not_have_is_refused():
    """It would do nothing."""
    status, _, said, _ = call("train.py", "--method", "ppo", "--rewards.pattern-tracking.weight", "2")
    assert status == 2
    assert "--rewards.pattern-tracking.weight" in said and "Traceback" not in said


@pytest.mark.parametrize("command", ["play", "evaluate", "compare", "benchmark", "publish", "export", "bad_states"])
def test_help_is_quick(command: str):
    """It loads nothing slow."""
    status, out, _, loaded = call("-m", f"aicpg_newton.{command}", "--help")
    assert (status, loaded) == (0, set()) and "usage:" in out


def test_a_simulation_loads_what_is_slow():
    """It is found where it is loaded."""
    quickly = ("--viewer", "none", "--agent", "zero", "--duration", "0.1", "--device", "cpu")
    status, _, _, loaded = call("play.py", *quickly)
    assert status == 0 and loaded >= {"newton", "warp", "rsl_rl", "tensordict"}
