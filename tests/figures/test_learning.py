"""Learning curves are read from logs, drawn from tables, and never mixed up."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from torch.utils.tensorboard import SummaryWriter

from aicpg_newton.curves import CurveOptions, main
from aicpg_newton.errors import UserError
from aicpg_newton.figures import learning
from aicpg_newton.learning import checkpoint
from aicpg_newton.places import ASSETS


def logged_run(folder: Path, iterations: int, *, from_iteration: int = 0, shift: float = 0.0) -> Path:
    """A run whose logged values are ten times the iteration, plus a shift."""
    folder.mkdir(exist_ok=True)
    shutil.copy(ASSETS / "policies" / "flat.pt", folder / "model_99.pt")
    with SummaryWriter(str(folder)) as writer:
        for step in range(from_iteration, iterations):
            for tag, _, _ in learning.CURVES.values():
                writer.add_scalar(tag, 10.0 * step + shift, step)
    return folder


def test_a_log_becomes_means_over_stretches(tmp_path: Path):
    """In units of the columns; samples go with the iterations as they do in the checkpoint."""
    rows = learning.read_run(logged_run(tmp_path / "run", 20), points=4)
    content = checkpoint.read(tmp_path / "run")
    assert [row["iteration"] for row in rows] == [5, 10, 15, 20]
    assert [row["slow_mps"] for row in rows] == [20.0, 70.0, 120.0, 170.0]
    assert rows[0]["episode_s"] == pytest.approx(20.0 / 60)
    assert rows[1]["samples"] == round(10 * content["samples"] / content["iteration"])
    assert (rows[0]["method"], rows[0]["task"], rows[0]["condition"]) == ("AI-CPG", "flat", "")


def test_what_was_done_again_after_a_resume_counts_once(tmp_path: Path):
    """A run that lost its last iterations logs them a second time, in another file."""
    logged_run(tmp_path / "run", 8)
    logged_run(tmp_path / "run", 10, from_iteration=6, shift=1.0)
    rows = learning.read_run(tmp_path / "run", points=100)
    assert [row["fast_mps"] for row in rows] == [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 61.0, 71.0, 81.0, 91.0]


def test_table_and_figure(tmp_path: Path):
    """The figure can be drawn again from the table alone; tables are never overwritten."""
    run, out = logged_run(tmp_path / "run", 6), tmp_path / "curves"
    table, picture = main(CurveOptions(runs=(run,), out=out, points=3))
    for read, made in zip(learning.read_table(table), learning.read_run(run, 3), strict=True):
        assert all(
            read[name] == (each if isinstance(each, str) else pytest.approx(each, rel=1e-5))
            for name, each in made.items()
        )
    first = picture.read_bytes()
    picture.unlink()
    assert main(CurveOptions(redraw=(out,), out=out)) == [picture] and picture.read_bytes() == first
    with pytest.raises(UserError, match=r"learning_curves.csv exists and would be overwritten"):
        main(CurveOptions(runs=(run,), out=out))


def test_bad_input(tmp_path: Path):
    """One sentence each, and nothing is written."""
    run, out = logged_run(tmp_path / "run", 2), tmp_path / "curves"
    empty = tmp_path / "empty"
    empty.mkdir()
    unlogged = tmp_path / "unlogged"
    unlogged.mkdir()
    shutil.copy(run / "model_99.pt", unlogged)
    for options, said in (
        ({}, "give either --runs"),
        ({"runs": (run,), "redraw": (run,)}, "give either --runs"),
        ({"runs": (tmp_path / "none",)}, "no run folder at"),
        ({"runs": (empty,)}, "no model_"),
        ({"runs": (unlogged,)}, "holds no log"),
        ({"runs": (run, run)}, "two runs are AI-CPG \\(flat\\), seed"),
        ({"redraw": (empty,)}, "there is no .*learning_curves.csv"),
        ({"runs": (run,), "points": 0}, "points"),
    ):
        with pytest.raises(UserError, match=said):
            main(replace(CurveOptions(out=out), **options))
    assert not out.exists()
    broken = empty / "learning_curves.csv"
    for text in ("a,b\n1,2\n", ",".join(learning.COLUMNS) + "\nflat,AI-CPG,,x,1,2,3,4,5,6\n"):
        broken.write_text(text)
        with pytest.raises(UserError, match="is no table of learning curves"):
            main(CurveOptions(out=out, redraw=(empty,)))
