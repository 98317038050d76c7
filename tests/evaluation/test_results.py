"""Result files: tidy, free of NaN, and never overwritten."""

import csv
import json
import math
from pathlib import Path

import pytest

from aicpg_newton.errors import UserError
from aicpg_newton.evaluation import results
from aicpg_newton.evaluation.protocols import PROTOCOLS, SPEED, SWEEP

CONTROLLERS = [{"method": "AI-CPG", "seed": 1, "task": "flat", "checkpoints": [{"file": "model_9.pt", "sha256": "ab"}]}]


def row(**changes) -> results.Row:
    """A row of the sweep."""
    numbers = {column: 0.5 for column in SWEEP.columns if column not in ("method", "condition", "seed", "reason")}
    return {"method": "AI-CPG", "condition": "", "seed": 1, **numbers, "reason": "", **changes}


def write(folder: Path, rows: list[results.Row]) -> None:
    """Write a sweep the way an evaluation does."""
    results.prepare(folder, ["sweep"], CONTROLLERS)
    results.write(folder, "sweep", rows, {"controllers": CONTROLLERS, "results": [{"value": math.nan}]})


def test_what_is_written_is_read(tmp_path: Path):
    """The columns in their order, six digits, and empty cells where a number is missing."""
    folder = tmp_path / "new" / "results"
    write(
        folder,
        [
            row(speed_mps=1.23456789),
            row(frequency_hz=0.6, cost_of_transport=math.nan, froude=None, reason="no motion; no way"),
        ],
    )
    with (folder / "sweep.csv").open() as file:
        lines = list(csv.reader(file))
    assert tuple(lines[0]) == (*SWEEP.columns, *SWEEP.further_columns) and len(lines) == 3
    assert lines[1][SWEEP.columns.index("speed_mps")] == "1.23457"
    assert lines[1][SWEEP.columns.index("seed")] == "1"
    assert lines[2][SWEEP.columns.index("cost_of_transport")] == ""
    assert "nan" not in (folder / "sweep.csv").read_text().lower()
    first, second = results.read_table(folder, "sweep")
    assert first["speed_mps"] == pytest.approx(1.23457) and first["reason"] == "" and first["method"] == "AI-CPG"
    assert math.isnan(second["froude"]) and second["reason"] == "no motion; no way"


def test_measures_of_version_0_1_are_refused(tmp_path: Path):
    """Its cost of transport and falls mean something else; what was withdrawn says so in its definitions."""
    results.prepare(tmp_path, ["sweep"], [])
    for definitions, refused in (({"falls": "pelvis low"}, True), ({"power": "withdrawn"}, False)):
        results.write(tmp_path, "sweep", [row()], {"controllers": [], "results": [], "definitions": definitions})
        if refused:
            with pytest.raises(UserError, match=r"version 0\.1"):
                results.read_table(tmp_path, "sweep")
        else:
            assert len(results.read_table(tmp_path, "sweep")) == 1


def test_further_columns_may_be_missing(tmp_path: Path):
    """They are read where they are there: earlier versions had some of them or none. Other columns are refused."""
    write(tmp_path, [row(environments=32, speed_mps_ci95=0.02, survived_low=0.89, turned_away_per_minute=0.5)])
    path = tmp_path / "sweep.csv"
    (read,) = results.read_table(tmp_path, "sweep")
    assert (read["environments"], read["speed_mps_ci95"], read["survived_low"]) == (32, 0.02, 0.89)
    assert math.isnan(read["survived_high"]) and read["turned_away_per_minute"] == 0.5
    whole = path.read_text()
    path.write_text("\n".join(line.rpartition(",")[0] for line in whole.splitlines()) + "\n")
    (read,) = results.read_table(tmp_path, "sweep")
    assert read["turned_away_per_minute"] == 0.5 and math.isnan(read["turned_away_per_minute_ci95"])
    path.write_text(whole.replace("survived_low", "survived_somehow"))
    with pytest.raises(UserError, match="does not have the columns"):
        results.read_table(tmp_path, "sweep")
    path.write_text(whole)
    cells = [line.split(",")[: len(SWEEP.columns)] for line in path.read_text().splitlines()]
    path.write_text("\n".join(map(",".join, cells)) + "\n")
    (read,) = results.read_table(tmp_path, "sweep")
    assert read["speed_mps"] == 0.5 and math.isnan(read["speed_mps_ci95"])


def test_json_is_strict(tmp_path: Path):
    """NaN becomes null, and the file says which controllers it is about."""
    write(tmp_path, [row()])
    content = json.loads((tmp_path / "sweep.json").read_text(), parse_constant=lambda word: pytest.fail(word))
    assert content["results"] == [{"value": None}] and content["controllers"] == CONTROLLERS
    assert not list(tmp_path.glob("*.partial"))


def test_an_empty_cell_needs_a_reason(tmp_path: Path):
    """A row without it is a mistake in the program."""
    with pytest.raises(AssertionError):
        write(tmp_path, [row(speed_mps=math.inf)])


def test_a_row_needs_a_frequency_or_a_condition(tmp_path: Path):
    """One of them is enough: a controller that follows no frequency is no failure."""
    write(tmp_path, [row(condition="1.5", frequency_hz=math.nan), row()])
    first, second = results.read_table(tmp_path, "sweep")
    assert (first["condition"], first["reason"]) == ("1.5", "") and math.isnan(first["frequency_hz"])
    assert second["condition"] == "" and second["frequency_hz"] == 0.5
    with pytest.raises(AssertionError):
        write(tmp_path / "neither", [row(frequency_hz=math.nan)])


def test_results_are_never_overwritten(tmp_path: Path):
    """Neither by the same protocol, nor mixed with those of another controller; another protocol may join."""
    write(tmp_path, [row()])
    before = (tmp_path / "sweep.csv").read_text()
    with pytest.raises(UserError, match="would be overwritten"):
        results.prepare(tmp_path, ["sweep"], CONTROLLERS)
    other = [{**CONTROLLERS[0], "checkpoints": [{"file": "model_9.pt", "sha256": "cd"}]}]
    with pytest.raises(UserError, match="other controllers"):
        results.prepare(tmp_path, ["speed"], other)
    results.prepare(tmp_path, ["speed"], CONTROLLERS)
    assert (tmp_path / "sweep.csv").read_text() == before


def test_bad_folders(tmp_path: Path):
    """A file in the way, a table that is not there, is of another kind, or was edited."""
    (tmp_path / "file").write_text("x")
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(UserError, match="cannot make the folder"):
            results.prepare(path, ["sweep"], CONTROLLERS)
    with pytest.raises(UserError, match="run the sweep protocol first"):
        results.read_table(tmp_path, "sweep")
    write(tmp_path, [row()])
    (tmp_path / "speed.csv").write_text((tmp_path / "sweep.csv").read_text())
    with pytest.raises(UserError, match="columns of the speed"):
        results.read_table(tmp_path, SPEED.name)
    text = (tmp_path / "sweep.csv").read_text()
    (tmp_path / "sweep.csv").write_text(text.replace("0.5", "fast", 1))
    with pytest.raises(UserError, match="not a number"):
        results.read_table(tmp_path, "sweep")
    (tmp_path / "sweep.json").write_text("{")
    (tmp_path / "speed.csv").unlink()
    with pytest.raises(UserError, match="cannot be read"):
        results.prepare(tmp_path, ["speed"], CONTROLLERS)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"survived": "7"}, "row 2 has a survived of 7, but shares are from 0 to 1"),
        ({"frequency_hz": "-0.8"}, "row 2 has a frequency_hz of -0.8, but frequencies are above 0"),
        ({"falls_per_minute": "-1"}, "row 2 has a falls_per_minute of -1, which is never negative"),
        ({"speed_mps": ""}, "row 2 has no speed_mps and no reason why"),
        ({"frequency_hz": ""}, "row 2 has neither a frequency_hz nor a condition"),
        ({"frequency_hz": "0.5"}, "row 2 is of the same as row 1"),
        (dict.fromkeys(SWEEP.columns, ""), "row 2 does not say of which method and seed it is"),
        ({"reason": "", "method": ""}, "row 2 does not say of which method and seed it is"),
    ],
)
def test_tables_that_were_edited_are_refused(tmp_path: Path, changes: dict[str, str], message: str):
    """Rows that no evaluation writes, by their number; they were drawn without a word."""
    write(tmp_path, [row(), row(frequency_hz=0.6, speed_mps_ci95=0.1)])
    assert len(results.read_table(tmp_path, "sweep")) == 2
    path = tmp_path / "sweep.csv"
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        columns, rows = reader.fieldnames or [], list(reader)
    rows[1] |= changes
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    with pytest.raises(UserError, match=message):
        results.read_table(tmp_path, "sweep")


def test_no_table_in_the_repository_is_taken_for_edited(monkeypatch: pytest.MonkeyPatch):
    """Whatever version wrote it."""
    monkeypatch.setattr(results, "read_description", lambda folder, name: {})
    root = Path(__file__).resolve().parents[2]
    tables = [path for folder in ("docs", "assets") for path in (root / folder).rglob("*.csv")]
    tables = [path for path in tables if path.stem in PROTOCOLS]
    assert len(tables) > 20
    for path in tables:
        assert results.read_table(path.parent, path.stem)
