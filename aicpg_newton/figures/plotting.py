"""What the figures have in common: methods that differ in grey, and means and standard deviations over seeds."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from aicpg_newton.env.methods import METHODS
from aicpg_newton.evaluation.results import Row
from aicpg_newton.files import WholeFile

REFERENCE = {"color": "0.45", "linewidth": 1.2}
"""Look of everything that is not a result."""

PAPERS_TRANSITION_MPS = (2.0, 2.8)
"""The paper's AI-CPG walks without flight up to the first and runs steadily from the second speed on (Fig. 3) [m/s]."""

PAPERS_TRANSITION_HZ = (0.93, 1.14)
"""The same as stride frequencies on its ramp (Fig. 4) [Hz]."""


@dataclass(frozen=True)
class Style:
    """Look of a method: colours of different lightness, and a marker and a line style each."""

    colour: str
    marker: str
    line: str | tuple[int, tuple[int, int]]
    hatch: str


_STYLES = {
    METHODS["ai-cpg"].title: Style("#b2182b", "o", "-", ""),
    METHODS["amp"].title: Style("#4393c3", "s", "--", "//"),
    METHODS["ppo"].title: Style("#1a6b32", "^", ":", "xx"),
}
_OTHERS = (
    Style("#000000", "D", "-.", ".."),
    Style("#8c6d1f", "v", (0, (5, 1)), "\\\\"),
    Style("#6a3d9a", "P", (0, (1, 3)), "oo"),
)


STYLES = (*_STYLES.values(), *_OTHERS)
"""Looks for whatever is no method, in the order in which they are to be taken."""


@dataclass(frozen=True)
class Points:
    """A method's means over seeds and how far they spread, one entry per frequency or condition.

    Spread is the standard deviation over seeds; of a single seed half the 95 % interval over its environments, or 0
    where that is not known.
    """

    x: np.ndarray
    y: np.ndarray
    x_spread: np.ndarray
    y_spread: np.ndarray
    survived: np.ndarray
    seeds: str
    """As :func:`number_of_seeds` has it, of those that have a value, and how many have none."""
    curve: bool
    """Whether the points are frequencies of one controller, not controllers trained for different speeds."""


def methods(rows: Iterable[Row]) -> dict[str, Style]:
    """Methods in their order of appearance, with their looks: the paper's colours for the paper's methods."""
    names = list(dict.fromkeys(row["method"] for row in rows))
    others = [name for name in names if name not in _STYLES]
    return {name: _STYLES.get(name) or _OTHERS[others.index(name) % len(_OTHERS)] for name in names}


def slug(method: str) -> str:
    """A method's name as part of a file name."""
    return re.sub(r"[^a-z0-9]+", "_", method.lower()).strip("_")


def mean(values: Iterable[float]) -> float:
    """Mean of the finite values; NaN where there are none."""
    finite = [value for value in values if math.isfinite(value)]
    return float(np.mean(finite)) if finite else math.nan


def std(values: Iterable[float]) -> float:
    """Standard deviation of the finite values; NaN where there are none."""
    finite = [value for value in values if math.isfinite(value)]
    return float(np.std(finite)) if finite else math.nan


def of_how_many(values: Iterable[float]) -> str:
    """How many of the seeds have a value, in words, where some have none: ``(2 of 3 seeds)``."""
    known = [math.isfinite(value) for value in values]
    return "" if all(known) else f"({sum(known)} of {len(known)} seeds)"


def number_of_seeds(rows: Iterable[Row]) -> str:
    """How many seeds of a method's trainings there are, in words: ``3 seeds``, ``1 to 3 seeds`` where they differ."""
    trainings: dict[str, set[float]] = {}
    for row in rows:
        trainings.setdefault(row["condition"], set()).add(row["seed"])
    numbers = sorted(map(len, trainings.values())) or [0]
    fewest, most = numbers[0], numbers[-1]
    return f"{f'{fewest} to ' if fewest < most else ''}{most} seed{'s' if most != 1 else ''}"


def over_seeds(rows: Iterable[Row], method: str, x: str, y: str) -> Points:
    """Mean and spread over seeds at each frequency or condition, where both ``x`` and ``y`` are known.

    Several rows of one seed (its last checkpoints) are averaged first, so that every seed counts the same.
    """
    groups: dict[float | str, dict[float, list[Row]]] = {}
    mine = [row for row in rows if row["method"] == method]
    known = [row for row in mine if math.isfinite(row[x]) and math.isfinite(row[y])]
    for row in known:
        told = row["condition"] or row["frequency_hz"]
        groups.setdefault(told, {}).setdefault(row["seed"], []).append(row)
    columns: list[tuple[float, ...]] = []
    for told in sorted(groups):
        per_seed = groups[told].values()
        xs, ys, survived = (
            [mean(row.get(name, 1.0) for row in each) for each in per_seed] for name in (x, y, "survived")
        )
        spreads: tuple[float, ...] = (std(xs), std(ys))
        if len(per_seed) == 1:
            only = next(iter(per_seed))
            halves = [mean(row.get(f"{name}_ci95", math.nan) for row in only) for name in (x, y)]
            spreads = tuple(half if math.isfinite(half) else 0.0 for half in halves)
        columns.append((mean(xs), mean(ys), *spreads, mean(survived)))
    table = np.array(columns).reshape(-1, 5).T
    curve = not any(isinstance(told, str) for told in groups)
    missing = len(
        {(row["condition"], row["seed"]) for row in mine} - {(row["condition"], row["seed"]) for row in known}
    )
    seeds = number_of_seeds(known) + (f", {missing} more without a value" if missing else "")
    return Points(table[0], table[1], table[2], table[3], table[4], seeds, curve)


def curves_over_time(rows: list[Row]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Mean and deviation of every column over time: over seeds, or over the environments of a single seed."""
    seeds = {row["seed"] for row in rows}
    steps: dict[float, list[Row]] = {}
    for row in rows:
        steps.setdefault(row["time_s"], []).append(row)
    ordered = [steps[time] for time in sorted(steps)]
    inside = {"speed_mps": "speed_std_mps", "flight_ratio": "flight_ratio_std"}
    curves = {}
    for column in ("time_s", "frequency_hz", "speed_mps", "froude", "flight_ratio", "standing"):
        means = np.array([mean(row[column] for row in each) for each in ordered])
        if len(seeds) > 1:
            spread = np.array([std(row[column] for row in each) for each in ordered])
        elif column in inside:
            spread = np.array([each[0][inside[column]] for each in ordered])
        else:
            spread = np.zeros(len(ordered))
        curves[column] = (means, spread)
    return curves


def draw_points(axes: Axes, points: Points, style: Style, label: str) -> None:
    """A method's points with their spread: standard deviations over seeds as in the paper, or a seed's own interval.

    The frequencies of one controller make a curve with a band; controllers trained for different speeds are dots, each
    with an ellipse as wide and high as the spread to both sides. Where under half of the environments survived, the
    marker is hollow and the curve leaves it out: such a point is made of the steps before a fall.
    """
    if not len(points.x):
        return
    label = f"{label} ({points.seeds})"
    fell = points.survived < 0.5
    look = {"color": style.colour, "marker": style.marker, "zorder": 3}
    line = style.line if points.curve else "none"
    axes.plot(points.x[~fell], points.y[~fell], linestyle=line, label=label, **look)
    axes.plot(points.x[fell], points.y[fell], linestyle="none", markerfacecolor="white", **look)
    faint = {"color": style.colour, "alpha": 0.2, "linewidth": 0}
    if points.curve:
        low, high = points.y - points.y_spread, points.y + points.y_spread
        axes.fill_between(points.x[~fell], low[~fell], high[~fell], **faint)
    else:
        for x, y, width, height in zip(points.x, points.y, points.x_spread, points.y_spread, strict=True):
            axes.add_patch(Ellipse((float(x), float(y)), 2 * float(width), 2 * float(height), **faint))


def say_if_empty(axes: Axes, rows: Iterable[Row], y: str) -> None:
    """Write into a panel without a single value why there is none."""
    rows = list(rows)
    if any(math.isfinite(row[y]) for row in rows):
        return
    reasons = sorted({reason for row in rows for reason in row["reason"].split("; ") if reason})
    text = "no values:\n" + "\n".join(reasons or ["this protocol was not run"])
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", wrap=True, color="0.2")


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, whole or not at all; its folder has to be there."""
    with WholeFile(path) as temporary:
        figure.savefig(temporary, dpi=100, format="png")
    return path


def mark_the_papers_transition(axes: Axes, start: float, end: float, label: str) -> None:
    """A band from where the paper's AI-CPG stops walking to where it runs, in the coordinates of the x axis."""
    colour = _STYLES[METHODS["ai-cpg"].title].colour
    axes.axvspan(start, end, facecolor=(colour, 0.06), edgecolor=(colour, 0.5), linestyle=":", label=label)
