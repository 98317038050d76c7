"""The pages: examples run, and links lead somewhere."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from aicpg_newton.engines.terrain import SHAPES, Ground, Terrain
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.methods import with_method
from aicpg_newton.env.task import Task
from aicpg_newton.gait.cpg import PatternNetwork

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_and_headings(page: Path):
    """Of this repository; those of the web are not tried."""
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if target.startswith("http"):
            continue
        path, _, heading = target.partition("#")
        file = page if not path else (page.parent / path).resolve()
        assert file.is_file(), target
        if heading:
            titles = re.findall(r"(?m)^#+ (.+)$", file.read_text())
            assert heading in {re.sub(r"[^a-z0-9 -]", "", title.lower()).replace(" ", "-") for title in titles}, target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_named_files_are_there(page: Path):
    """Paths of the code, as pages name them."""
    for path in re.findall(r"`((?:aicpg_newton|tests|tasks|assets)/[\w/.]*)`", page.read_text(encoding="utf-8")):
        assert (ROOT / path).exists() or path == "tasks/quiet.py", path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_have_rows_of_one_width(page: Path):
    """At least one below the head, and as many cells in each; a bar within a cell has a backslash."""
    for table in re.findall(r"(?m)(?:^ *\|.*\n)+", page.read_text(encoding="utf-8")):
        rows = table.splitlines()
        assert len(rows) > 2, rows[0]
        assert len({len(re.findall(r"(?<!\\)\|", row)) for row in rows}) == 1, rows[0]


def test_what_reliability_rests_on_is_there():
    """Every test that the page names, by file and function."""
    named = re.findall(r"`([\w/]+\.py)(?:::(\w+))?`", (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8"))
    assert len(named) > 30
    for file, test in named:
        assert f"def {test}" in (ROOT / "tests" / file).read_text(encoding="utf-8"), (file, test)


def test_the_front_page_is_short():
    """What it is, how to begin, pictures, results in brief, links."""
    assert len((ROOT / "README.md").read_text().splitlines()) < 200


def test_the_examples_of_the_page_on_extending(puppet, pattern: PatternNetwork, monkeypatch: pytest.MonkeyPatch):
    """A reward, an observation and a kind of ground, as they stand there."""
    examples = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "extending.md").read_text(), re.DOTALL)
    assert len(examples) == 3
    names: dict[str, Any] = {"np": np, "Ground": Ground}
    exec(examples[0], names)
    names["task"] = names["quiet"]()
    exec(examples[1], names)
    exec(examples[2], names)
    task = names["task"]
    assert isinstance(task, Task)
    monkeypatch.setitem(SHAPES, "steps", names["steps"])
    task.ground = Ground(height_range=0.15, shape="steps", feature=1.0, length=24.0, width=16.0)
    terrain = Terrain.make(task.ground)
    assert terrain is not None and len(terrain.heights.unique()) > 15
    engine = puppet(2, terrain)
    engine.overrides["foot_force"] = torch.tensor([[[0.0, 0.0, 1200.0], [0.0, 0.0, 100.0]]]).repeat(2, 1, 1)
    environment = Environment(with_method(task, "ai-cpg"), engine, pattern)
    assert environment.step(torch.zeros(2, 28))[0]["policy"].shape == (2, 193)
    paid = environment.outcome.reward_terms["soft_feet"][~environment.outcome.fallen]
    assert paid.tolist() == pytest.approx([0.01 * -0.2 * 0.5] * len(paid))
