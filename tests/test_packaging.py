"""What the package says about itself: what it needs, what it brings, and where its tasks come from."""

import ast
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import yaml

import aicpg_newton
from aicpg_newton import places
from aicpg_newton.env import registry
from aicpg_newton.env.registry import get_task, task_from_dict
from aicpg_newton.env.stored import to_dict
from aicpg_newton.errors import UserError

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def names(requirements: list[str]) -> set[str]:
    """Names of the packages in a list of requirements."""
    return {re.split(r"[^\w.-]", each)[0].lower() for each in requirements}


def imported() -> set[str]:
    """Top-level modules that the package imports from elsewhere, at the top of a file or within a function."""
    modules = set()
    for path in [*(ROOT / "aicpg_newton").rglob("*.py"), *(ROOT / "tasks").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                modules |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                modules.add(node.module.split(".")[0])
    return modules - sys.stdlib_module_names - {"aicpg_newton"}


def test_what_is_imported_is_declared_and_the_other_way_round():
    """Nothing comes along by chance with something else."""
    of_module = {module: {each.lower() for each in found} for module, found in packages_distributions().items()}
    declared = names(PROJECT["dependencies"])
    missing = {module for module in imported() if not of_module[module] & declared}
    assert not missing
    assert declared == set.union(*(of_module[module] & declared for module in imported()))


def test_releases_that_change_their_ways_are_bounded():
    """And the tools of the tests are one release each."""
    bounds = {re.split(r"[^\w.-]", each)[0]: each for each in PROJECT["dependencies"]}
    assert bounds["newton"] == "newton[sim]~=1.8.0"
    assert bounds["rsl-rl-lib"] == "rsl-rl-lib~=5.5.1"
    assert re.fullmatch(r"torch>=[\d.]+,<[\d.]+", bounds["torch"])
    pinned = (ROOT / ".ci" / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = [line for line in pinned if not line.startswith("#")]
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in pinned)
    tools = {each for each in PROJECT["optional-dependencies"]["test"] if "==" in each}
    assert {each.split("==")[0] for each in tools} == {"ruff", "pyright"} and tools <= set(pinned)
    assert names(PROJECT["dependencies"]) <= {line.split("==")[0].lower() for line in pinned}


def test_the_licence_is_named_once_for_machines_and_once_for_readers():
    """The same one."""
    assert PROJECT["license"] == "Apache-2.0"
    assert "Apache License" in (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert "Apache-2.0" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_it_can_be_cited():
    """Paper and software, with the version of the package."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == aicpg_newton.__version__
    assert citation["license"] == PROJECT["license"]
    assert citation["references"][0]["title"].startswith("AI-CPG: Adaptive Imitated Central Pattern Generators")


def test_commands_are_there():
    """Each names a function that is there, and ``python -m`` calls the same one."""
    assert set(PROJECT["scripts"]) == {"aicpg-train", "aicpg-play", "aicpg-evaluate"}
    for target in PROJECT["scripts"].values():
        module, _, function = target.partition(":")
        assert callable(getattr(__import__(module, fromlist=[function]), function))


@pytest.mark.parametrize("script", ["train.py", "play.py"])
def test_the_scripts_of_a_checkout_work_from_anywhere(tmp_path: Path, script: str):
    """Without an installation, and beside a module of somebody else that is called tasks."""
    (tmp_path / "tasks.py").write_text("raise SystemExit('not this one')\n", encoding="utf-8")
    done = subprocess.run([sys.executable, ROOT / script, "--help"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "--task" in done.stdout


def test_an_installed_package_can_bring_a_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """By an entry point; what a checkpoint holds of it finds its code again."""
    (tmp_path / "somebodys.py").write_text(
        "from aicpg_newton.env.rewards import RewardTerm\n"
        "from aicpg_newton.env.task import Task\n"
        "def still(view):\n"
        "    return view.state.root_position[:, 0]\n"
        "def quiet():\n"
        "    task = Task(name='quiet')\n"
        "    task.rewards['still'] = RewardTerm(still, weight=-0.5)\n"
        "    return task\n"
        "def other():\n"
        "    return quiet()\n"
        "def broken():\n"
        "    raise RuntimeError('no luck')\n",
        encoding="utf-8",
    )
    info = tmp_path / "somebodys-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: somebodys\nVersion: 1.0\n", encoding="utf-8")
    points = "".join(f"{name} = somebodys:{name}\n" for name in ("quiet", "other", "broken"))
    (info / "entry_points.txt").write_text(f"[{registry.GROUP}]\n{points}", encoding="utf-8")
    with pytest.raises(UserError, match=r"unknown task 'quiet'; choose one of: flat, uneven, robust$"):
        get_task("quiet")
    monkeypatch.syspath_prepend(str(tmp_path))
    task = get_task("quiet")
    assert task.rewards["still"].weight == -0.5
    task.rewards["still"].weight = -2.0
    again = task_from_dict(to_dict(task), "a checkpoint")
    assert again.rewards["still"].weight == -2.0 and again.rewards["still"].function is task.rewards["still"].function
    with pytest.raises(UserError, match="unknown task 'moon'; choose one of: flat, uneven, robust, quiet, other"):
        get_task("moon")
    with pytest.raises(UserError, match="'broken' is declared as somebodys:broken, which fails: no luck"):
        get_task("broken")
    with pytest.raises(UserError, match="'other' is declared as somebodys:other, which gives no Task of that name"):
        get_task("other")


def test_the_tasks_are_those_beside_the_package():
    """In a checkout; the wheel is tried by ``.ci/wheel``."""
    assert not places.INSTALLED
    assert places.TASKS == ROOT / "tasks"
    assert sys.modules["aicpg_newton.tasks"].__file__ == str(ROOT / "tasks" / "__init__.py")


@pytest.mark.parametrize(("installed", "words"), [(False, "python train.py"), (True, "aicpg-train")])
def test_advice_names_the_command_that_is_there(installed: bool, words: str, monkeypatch: pytest.MonkeyPatch):
    """A wheel has no train.py."""
    monkeypatch.setattr(places, "INSTALLED", installed)
    assert places.command("train") == words
