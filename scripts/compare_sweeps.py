"""Variants of one controller side by side: python scripts/compare_sweeps.py --sweeps FOLDER FOLDER --out picture.png.

Each folder holds the sweep.csv of a variant, with as many seeds as there are; its name is the name of the variant.
Controllers that follow no stride frequency are left out. What ``evaluate --redraw`` draws over speed, for methods, this
draws over the stride frequency.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import tyro
from matplotlib.figure import Figure

from aicpg_newton.errors import UserError, run_command
from aicpg_newton.evaluation import results
from aicpg_newton.evaluation.protocols import SWEEP
from aicpg_newton.figures.plotting import STYLES, over_seeds, save

PANELS = {
    "survived": "share that stood for 20 s",
    "speed_mps": "speed [m/s]",
    "cost_of_transport": "cost of transport",
    "symmetry_index": "symmetry index",
}


@dataclass(kw_only=True)
class CompareOptions:
    """What to draw, and where to."""

    sweeps: tuple[Path, ...]
    """Folders, each with a sweep.csv."""
    names: tuple[str, ...] = ()
    """What the variants are called, where the names of the folders do not tell."""
    out: Path
    """Picture, .png, which is drawn anew."""


def draw(tables: dict[str, list[results.Row]]) -> Figure:
    """Mean over seeds of each variant at each frequency; shaded: standard deviation over seeds, thin: each seed."""
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    for axes, (column, title) in zip(figure.subplots(2, 2, sharex=True).flat, PANELS.items(), strict=True):
        for style, (name, rows) in zip(cycle(STYLES), tables.items(), strict=False):
            points = over_seeds(rows, rows[0]["method"], "frequency_hz", column)
            look = {"color": style.colour, "marker": style.marker, "linestyle": style.line, "markersize": 4}
            axes.plot(points.x, points.y, **look, label=f"{name}, {points.seeds}")
            low, high = points.y - points.y_spread, points.y + points.y_spread
            axes.fill_between(points.x, low, high, color=style.colour, alpha=0.15, linewidth=0)
            for seed in sorted({row["seed"] for row in rows}):
                mine = [row for row in rows if row["seed"] == seed]
                axes.plot(
                    [row["frequency_hz"] for row in mine],
                    [row[column] for row in mine],
                    color=style.colour,
                    linewidth=0.6,
                )
        axes.set(title=title, ylim=(0.0, None))
        axes.tick_params(labelbottom=True)
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize="small")
    figure.supxlabel("stride frequency [Hz]", fontsize="medium")
    return figure


def main(options: CompareOptions) -> None:
    """Draw.

    Raises:
        UserError: A folder holds no sweep, or the sweep of a controller that follows no frequency.
    """
    names = options.names or tuple(folder.name for folder in options.sweeps)
    if len(names) != len(options.sweeps):
        raise UserError(f"--names are {len(names)}, folders {len(options.sweeps)}; give a name for each, or none")
    if len(set(names)) < len(names):
        raise UserError("two of the folders have the same name; give --names, as they stand in the picture")
    tables = {name: results.read_table(folder, SWEEP.name) for name, folder in zip(names, options.sweeps, strict=True)}
    tables = {name: [row for row in rows if not row["condition"]] for name, rows in tables.items()}
    for name, rows in tables.items():
        if not rows:
            raise UserError(f"{name} holds no sweep over stride frequencies; give one of AI-CPG")
    if options.out.suffix != ".png":
        raise UserError(f"--out is {options.out}; give a name that ends in .png")
    print(f"Figure: {save(draw(tables), options.out)}")


if __name__ == "__main__":
    run_command(lambda: main(tyro.cli(CompareOptions, description=__doc__)))
