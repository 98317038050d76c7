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
        UserError: The file is missing, has other columns, a cell that is no number, or measures of version 0.1.
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
        return [
            {key: text if key in _TEXT else number(text) if text else math.nan for key, text in row.items()}
            for row in rows
        ]
    except ValueError as error:
        raise UserError(f"{path} holds a cell that is not a number ({error}); evaluate again") from error


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
        content = json.loads(read_text(path))
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
