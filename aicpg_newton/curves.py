"""Learning curves of trainings as a table and a figure: python -m aicpg_newton.curves --runs RUN RUN --out curves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from aicpg_newton.errors import UserError, run_command
from aicpg_newton.figures import learning
from aicpg_newton.figures.plotting import save
from aicpg_newton.files import make_folder, write_text
from aicpg_newton.ranges import AT_LEAST_ONE, check_ranges

NAME = "learning_curves"
"""Name of the table and of the figure."""


@dataclass(kw_only=True)
class CurveOptions:
    """Which trainings, and where table and figure go."""

    out: Path
    """Folder for learning_curves.csv, which is never overwritten, and learning_curves.png, which is drawn anew."""
    runs: tuple[Path, ...] = ()
    """Run folders."""
    points: Annotated[int, AT_LEAST_ONE] = 100
    """Points of each curve: means over as many stretches of a training."""
    redraw: tuple[Path, ...] = ()
    """Only draw the figure, from the tables of these folders together."""


def main(options: CurveOptions) -> list[Path]:
    """Write table and figure; give the files.

    Raises:
        UserError: An option cannot be met, or a run holds no log.
    """
    check_ranges(options, "--")
    if bool(options.runs) == bool(options.redraw):
        raise UserError("give either --runs, to read logs, or --redraw, to draw from tables that are there")
    table = options.out / f"{NAME}.csv"
    if options.runs and table.exists():
        raise UserError(f"{table} exists and would be overwritten; give --out another folder or move it away")
    if options.runs:
        rows = [row for run in options.runs for row in learning.read_run(run, options.points)]
    else:
        rows = [row for folder in options.redraw for row in learning.read_table(folder / f"{NAME}.csv")]
    learning.refuse_twins(rows)
    make_folder(options.out)
    if options.runs:
        write_text(table, learning.as_csv(rows))
    picture = save(learning.draw(rows), table.with_suffix(".png"))
    print(f"Figure: {picture}")
    return [table, picture] if options.runs else [picture]


def command() -> None:
    """What ``python -m aicpg_newton.curves`` does."""
    run_command(lambda: main(tyro.cli(CurveOptions, description=__doc__)))


if __name__ == "__main__":
    command()
