"""Figures of uneven terrain: trajectories as training goes on (Fig. 5 a), walking and running compared (Fig. 5 b)."""

from __future__ import annotations

import math

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from aicpg_newton.evaluation.protocols import GAITS
from aicpg_newton.evaluation.results import Row
from aicpg_newton.evaluation.terrain_summaries import SAMPLE
from aicpg_newton.figures.plotting import Style, mean, methods, number_of_seeds, of_how_many, std
from aicpg_newton.robot.humanoid import CONTROL_DT
from aicpg_newton.texts import number

_PAPER_SPEED = {"walking": 1.5, "running": 3.0}  # [m/s]
_SHADES = ListedColormap(matplotlib.colormaps["viridis"](np.linspace(0.0, 0.93, 256)))  # its end is too pale on white
_MEASURES = {
    "speed_mps": "speed [m/s]",
    "symmetry_index": "symmetry index",
    "balance_index": "balance index",
    "cost_of_transport": "cost of transport",
    "survived": "share that never fell in 20 s",
}


def trajectories_figure(rows: list[Row]) -> Figure:
    """Fig. 5 a: where robots go, and their velocities, by checkpoints from early (dark) to late (light)."""
    names = list(methods(rows))
    figure = Figure(figsize=(13, 1.2 + 2.8 * len(names)), layout="constrained")
    panels = figure.subplots(len(names), len(GAITS), sharex="col", sharey="col", squeeze=False)
    iterations = [row["iteration"] for row in rows]
    shade = Normalize(min(iterations), max(max(iterations), min(iterations) + 1))
    for method, line in zip(names, panels, strict=True):
        for gait, axes in zip(GAITS, line, strict=True):
            mine = nearest_to_the_paper([row for row in rows if row["method"] == method and row["gait"] == gait], gait)
            _draw_trajectories(axes, mine, shade)
            axes.set_title(", ".join(filter(None, (method, gait, _told(mine)))), fontsize="medium")
            axes.grid(alpha=0.3)
    for axes in panels[-1]:
        axes.set_xlabel("x, the target direction [m]")
    for axes in panels[:, 0]:
        axes.set_ylabel("y [m]")
    figure.colorbar(ScalarMappable(shade, _SHADES), ax=panels, label="training iteration", aspect=40)
    figure.supxlabel(
        "Ten seconds from the start, or up to the first fall (cross); an arrow is the way of half a second.",
        fontsize="small",
    )
    return figure


def _draw_trajectories(axes: Axes, rows: list[Row], shade: Normalize) -> None:
    """Arrows of all trajectories of a panel, the latest checkpoints on top, and a cross where one fell."""
    known = [row for row in rows if math.isfinite(row["vx_mps"]) and math.isfinite(row["vy_mps"])]
    known.sort(key=lambda row: row["iteration"])
    if not rows:
        axes.text(0.5, 0.5, "not tested", ha="center", va="center", transform=axes.transAxes, color="0.2")
        return
    x, y, vx, vy, iteration = (
        np.array([row[name] for row in known]) for name in ("x_m", "y_m", "vx_mps", "vy_mps", "iteration")
    )
    colours = _SHADES(shade(iteration))
    seconds = SAMPLE * CONTROL_DT
    # From where the robot was half a second before to where it is, so that arrows make up the trajectory.
    axes.quiver(
        *(x - seconds * vx, y - seconds * vy, seconds * vx, seconds * vy),
        **{"color": colours, "angles": "xy", "scale_units": "xy", "scale": 1.0, "width": 0.0025, "zorder": 3},
    )
    fell = np.array([row["reason"].startswith("fell") for row in known], dtype=bool)
    axes.scatter(x[fell], y[fell], c=colours[fell], marker="x", s=24, zorder=4)
    axes.plot(0.0, 0.0, "+", color="k", markersize=8, zorder=5)
    axes.update_datalim(np.stack((x, y), axis=1))
    axes.autoscale_view()
    low, high = axes.get_ylim()
    reach = max(2.0, -low, high)
    axes.set_ylim(-reach, reach)


def _told(rows: list[Row]) -> str:
    """What the controllers of a panel were told, for its title."""
    if not rows:
        return ""
    condition = rows[0]["condition"]
    if not condition:
        return f"f = {rows[0]['frequency_hz']:g} Hz"
    return f"trained to {condition}" if math.isnan(_speed(condition)) else f"trained for {condition} m/s"


def _speed(condition: str) -> float:
    """Speed that a controller was trained for [m/s]; NaN where its condition is none."""
    try:
        return number(condition)
    except ValueError:
        return math.nan


def nearest_to_the_paper(rows: list[Row], gait: str) -> list[Row]:
    """Of one method's rows of a gait those of the condition trained for the paper's speed, 1.5 or 3.0 m/s, or near it.

    Conditions that are no speeds, and stride frequencies, are kept.
    """
    off = {row["condition"]: abs(_speed(row["condition"]) - _PAPER_SPEED[gait]) for row in rows}
    best = min(off, key=lambda condition: np.nan_to_num(off[condition]), default="")
    return [row for row in rows if row["condition"] == best]


def walking_and_running_figure(rows: list[Row]) -> Figure:
    """Fig. 5 b: bars of the mean over seeds with standard deviations; over terrains where there is a single seed."""
    figure = Figure(figsize=(15, 4.4), layout="constrained")
    looks = methods(rows)
    for axes, (column, title) in zip(figure.subplots(1, len(_MEASURES)), _MEASURES.items(), strict=True):
        for index, (method, style) in enumerate(looks.items()):
            for place, gait in enumerate(GAITS):
                mine = [row for row in rows if row["method"] == method and row["gait"] == gait]
                width = 0.8 / len(looks)
                x = place + width * (index - 0.5 * (len(looks) - 1))
                _draw_bar(axes, x, width, nearest_to_the_paper(mine, gait), column, style)
        axes.set(title=title, xticks=range(len(GAITS)), xlim=(-0.6, len(GAITS) - 0.4))
        axes.margins(y=0.12)
        if column == "survived" or not axes.patches:
            axes.set_ylim(0.0, 1.1)
        axes.set_xticklabels(list(GAITS))
    handles = [
        Patch(facecolor=style.colour, hatch=style.hatch, edgecolor="white", label=_label(rows, method))
        for method, style in looks.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", frameon=False, fontsize="small")
    figure.suptitle(
        "On uneven terrain; all but the last panel: after the first second and before the first fall", fontsize="medium"
    )
    return figure


def _draw_bar(axes: Axes, x: float, width: float, rows: list[Row], column: str, style: Style) -> None:
    """One bar with its value; a word where there is none."""
    value, deviation, known = _mean_and_spread(rows, column)
    if not math.isfinite(value):
        word = "fell at once" if rows else "not tested"
        axes.text(x, 0.02, word, rotation=90, ha="center", va="bottom", transform=axes.get_xaxis_transform())
        return
    axes.bar(
        *(x, value, 0.9 * width),
        yerr=deviation if deviation else None,
        **{"color": style.colour, "hatch": style.hatch, "edgecolor": "white", "ecolor": "black", "capsize": 4},
    )
    place = {"xytext": (0, 4), "textcoords": "offset points", "ha": "center"}
    axes.annotate(f"{value:.2f}\n{known}" if known else f"{value:.2f}", (x, value + deviation), fontsize=8, **place)


def _mean_and_spread(rows: list[Row], column: str) -> tuple[float, float, str]:
    """Mean over seeds, each the mean over its terrains, and their deviation; over terrains for a single seed.

    The text says how many seeds have a value, where some have none.
    """
    seeds = sorted({row["seed"] for row in rows})
    values = [mean(row[column] for row in rows if row["seed"] == seed) for seed in seeds]
    spread = std(values) if len(seeds) > 1 else std(row[column] for row in rows)
    return mean(values), spread if math.isfinite(spread) else 0.0, of_how_many(values)


def _label(rows: list[Row], method: str) -> str:
    """A method's name, what its bars are made of, and what was told."""
    mine = [row for row in rows if row["method"] == method]
    bars = [nearest_to_the_paper([row for row in mine if row["gait"] == gait], gait) for gait in GAITS]
    shown = [row for bar in bars for row in bar]
    seeds, terrains = (len({row[name] for row in shown}) for name in ("seed", "terrain_seed"))
    told = " and ".join(filter(None, map(_told, bars)))
    count = f"{number_of_seeds(shown)} on {terrains} terrains"
    return f"{method}, {told}: {count}, deviation over {'seeds' if seeds > 1 else 'terrains'}"
