"""Results on disk: per protocol one tidy CSV file of numbers and one JSON file with where they come from.

A cell without a number is empty, never NaN, and then the row's ``reason`` says why. Only what a controller was told may
be empty without a reason: a row has a stride frequency, or the condition of a controller that follows none. A folder
holds the results of one evaluation: files that exist are never overwritten, and a protocol may be added only for the
same controllers on the same ground.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from aicpg_newton.errors import UserError
from aicpg_newton.evaluation.protocols import PROTOCOLS
from aicpg_newton.files import make_folder, write_text
from aicpg_newton.texts import number, read_text

Row = dict[str, Any]
"""Column to number or text; None or NaN for a cell without a number."""

_TEXT = ("method", "condition", "gait", "reason")
_TOLD = ("frequency_hz", "condition")
_NAMES = (
    *("method", "condition", "gait", "seed", "terrain_seed", "iteration", "environment"),
    *("commanded_mps", "frequency_hz", "time_s"),
)
"""Columns that tell the rows of a table apart, as far as it has them."""

_SHARES = ("survived", "survived_low", "survived_high", "standing", "turned_away", "flight_ratio")
_SHARES += ("right_contact", "left_contact")
_NEVER_NEGATIVE = ("seed", "terrain_seed", "iteration", "environment", "environments", "time_s", "falls_per_minute")
_NEVER_NEGATIVE += ("turned_away_per_minute", "cost_of_transport", "symmetry_index", "froude")


def prepare(folder: Path, names: Iterable[str], controllers: list[dict[str, Any]]) -> None:
    """Make the folder, once it is sure that nothing in it would be overwritten or mixed up.

    Args:
        folder: Where results go.
        names: Protocols that will be written.
        controllers: What :func:`write` will be told of the controllers.

    Raises:
        UserError: The folder holds one of these protocols or another evaluation, or cannot be written to.
    """
    for name in names:
        for path in (folder / f"{name}.csv", folder / f"{name}.json"):
            if path.exists():
                raise UserError(f"{path} exists and would be overwritten; give --out another folder or move it away")
    for name in PROTOCOLS:
        path = folder / f"{name}.json"
        if path.exists() and read_description(folder, name)["controllers"] != controllers:
            raise UserError(f"{folder} holds results of other controllers or ground; give --out another folder")
    make_folder(folder)


def write(folder: Path, name: str, rows: Sequence[Row], description: dict[str, Any]) -> None:
    """Write ``name.csv`` and ``name.json``; each appears whole or not at all.

    Args:
        folder: A folder that :func:`prepare` has checked.
        name: Protocol.
        rows: One entry per line, with the protocol's columns.
        description: Where the numbers come from, and the summary; numbers that are not finite become null.
    """
    needs, further = PROTOCOLS[name].columns, PROTOCOLS[name].further_columns
    lines = [
        {**{column: _cell(row[column]) for column in needs}, **{column: _cell(row.get(column)) for column in further}}
        for row in rows
    ]
    for line in lines:
        needed = [line[column] for column in needs if column not in ("reason", *_TOLD)]
        assert line["reason"] or (all(needed) and any(line.get(column) for column in _TOLD)), line
    table = io.StringIO(newline="")
    writer = csv.DictWriter(table, (*needs, *further), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    write_text(folder / f"{name}.csv", table.getvalue())
    write_text(folder / f"{name}.json", json.dumps(_plain(description), indent=1, allow_nan=False) + "\n")


def read_table(folder: Path, name: str) -> list[Row]:
    """Rows of a protocol's CSV file, numbers as floats and empty cells as NaN; so are further columns that are missing.

    Raises:
        UserError: The file is missing, has other columns, a cell that is no number, measures of version 0.1, or a row
            that no evaluation writes: given twice, empty without a reason, or with a number that cannot be.
    """
    path = folder / f"{name}.csv"
    if not path.is_file():
        raise UserError(f"there is no {path}; run the {name} protocol first")
    if path.with_suffix(".json").exists():
        definitions = read_description(folder, name).get("definitions")
        if isinstance(definitions, dict) and "power" not in definitions:
            raise UserError(
                f"{path} was written by version 0.1, which sampled power once a control step and counted turning away"
                " as a fall; evaluate again into another folder"
            )
    try:
        reader = csv.DictReader(io.StringIO(read_text(path), newline=""), strict=True)
        columns, further = PROTOCOLS[name].columns, PROTOCOLS[name].further_columns
        found = tuple(reader.fieldnames or ())
        if found[: len(columns)] != columns or not set(found[len(columns) :]) <= set(further):
            raise UserError(f"{path} does not have the columns of the {name} protocol; evaluate again")
        rows = [{**dict.fromkeys(further, ""), **row} for row in reader]
    except csv.Error as error:
        raise UserError(f"{path} is no CSV file ({error}); evaluate again") from error
    for row in rows:
        if None in row or None in row.values():
            raise UserError(f"{path} has a row of another length than its first; evaluate again")
    try:
        table = [
            {key: text if key in _TEXT else number(text) if text else math.nan for key, text in row.items()}
            for row in rows
        ]
    except ValueError as error:
        raise UserError(f"{path} holds a cell that is not a number ({error}); evaluate again") from error
    seen: dict[tuple, int] = {}
    for place, (row, texts) in enumerate(zip(table, rows, strict=True), start=1):
        fault = _fault(row, columns)
        same = seen.setdefault(tuple(texts.get(name) for name in _NAMES), place)
        if same != place:
            fault = f"is of the same as row {same}"
        if fault:
            raise UserError(f"{path}: row {place} {fault}; evaluate again, or fix the table")
    return table


def _fault(row: Row, needs: Sequence[str]) -> str:
    """What an evaluation would not have written in a row, in words; empty where there is nothing."""
    empty = [name for name in needs if name not in (*_TEXT, *_TOLD) and math.isnan(row[name])]
    if not row["method"] or math.isnan(row["seed"]):
        return "does not say of which method and seed it is"
    if not row["reason"] and empty:
        return f"has no {empty[0]} and no reason why"
    if not row["reason"] and not row.get("condition") and math.isnan(row.get("frequency_hz", 0.0)):
        return "has neither a frequency_hz nor a condition"
    if row.get("frequency_hz", 1.0) <= 0.0:
        return f"has a frequency_hz of {row['frequency_hz']:g}, but frequencies are above 0"
    for name, value in row.items():
        if name in _SHARES and not 0.0 <= value <= 1.0 and not math.isnan(value):
            return f"has a {name} of {value:g}, but shares are from 0 to 1"
        if (name in _NEVER_NEGATIVE or name.endswith("_ci95")) and value < 0.0:
            return f"has a {name} of {value:g}, which is never negative"
    return ""


def read_together(folders: Iterable[Path], name: str) -> list[Row]:
    """Rows of a protocol from all folders that hold it.

    Raises:
        UserError: As :func:`read_table`, or two folders hold the same training.
    """
    rows: list[Row] = []
    seen: set[tuple] = set()
    for folder in folders:
        if not (folder / f"{name}.csv").exists():
            continue
        new = read_table(folder, name)
        keys = {(row["method"], row.get("condition", ""), row["seed"]) for row in new}
        if keys & seen:
            method, condition, seed = min(keys & seen)
            who = f"{method} {condition}".strip()
            raise UserError(f"two of the folders hold {name} results of {who}, seed {seed:g}; give one at a time")
        seen |= keys
        rows += new
    return rows


def read_description(folder: Path, name: str) -> dict[str, Any]:
    """Content of a protocol's JSON file.

    Raises:
        UserError: The file is missing, torn or not of a protocol.
    """
    path = folder / f"{name}.json"
    broken = UserError(f"{path} cannot be read; run the {name} protocol into another folder")
    try:
        content = json.loads(read_text(path), parse_constant=number)  # which takes no NaN and no Infinity
    except (ValueError, RecursionError, UserError) as error:
        raise broken from error
    lists = [content.get(key) for key in ("controllers", "results")] if isinstance(content, dict) else [None]
    if not all(isinstance(each, list) and all(isinstance(entry, dict) for entry in each) for each in lists):
        raise broken
    return content


def _number(text: str) -> float:
    """Number of a CSV cell; NaN where it is empty."""
    return number(text) if text else math.nan


def _cell(value: Any) -> str:
    """Text of a CSV cell: six significant digits, whole numbers as they are, nothing for no number."""
    if value is None or isinstance(value, str):
        return value or ""
    if isinstance(value, int):
        return str(value)
    return f"{value:.6g}" if math.isfinite(value) else ""


def _plain(value: Any) -> Any:
    """The same content with None in place of numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
