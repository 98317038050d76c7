"""Up and down again: does the gait change at the same stride frequency both ways?"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from aicpg_newton.evaluation.protocols import UP_AND_DOWN
from aicpg_newton.evaluation.results import Row
from aicpg_newton.evaluation.transition_summaries import TRANSITION_FROUDE
from aicpg_newton.figures.plotting import (
    PAPERS_TRANSITION_HZ,
    REFERENCE,
    curves_over_time,
    mark_the_papers_transition,
    mean,
    methods,
    of_how_many,
    say_if_empty,
)


def hysteresis_figure(rows: list[Row], found: list[dict[str, Any]]) -> Figure:
    """Speed, Froude number and flight over stride frequency, rising and falling, of all methods.

    Args:
        rows: Rows of ``up_and_down.csv``.
        found: The entries of ``results`` in ``up_and_down.json``.
    """
    figure = Figure(figsize=(12, 4.8), layout="constrained")
    panels = dict(zip(("speed_mps", "froude", "flight_ratio"), figure.subplots(1, 3), strict=True))
    titles = {"speed_mps": "speed [m/s]", "froude": "Froude number", "flight_ratio": "flight phase ratio"}
    for method, style in methods(rows).items():
        curves = curves_over_time([row for row in rows if row["method"] == method])
        time, frequency = curves["time_s"][0], curves["frequency_hz"][0]
        turn = int(np.searchsorted(time, UP_AND_DOWN.duration / 2))
        for column, axes in panels.items():
            value = curves[column][0]
            for way, steps, line in (("up", slice(None, turn), "-"), ("down", slice(turn, None), "--")):
                label = f"{method}, {way}"
                axes.plot(frequency[steps], value[steps], color=style.colour, linestyle=line, label=label)
        for way, line in (("up", "-"), ("down", "--")):
            changes = [each[way]["transition_frequency_hz"]["mean"] for each in found if each["method"] == method]
            changes = [np.nan if change is None else change for change in changes]
            where = mean(changes)
            if np.isfinite(where):
                label = f"{method}, {way}: Fr = 0.5 at {where:.3f} Hz {of_how_many(changes)}".rstrip()
                panels["froude"].axvline(where, color=style.colour, linestyle=line, linewidth=0.8, label=label)
    panels["froude"].axhline(TRANSITION_FROUDE, **REFERENCE, linestyle=":")
    mark_the_papers_transition(panels["flight_ratio"], *PAPERS_TRANSITION_HZ, "the paper's change of gait, going up")
    for column, axes in panels.items():
        axes.set(title=titles[column], xlabel="stride frequency [Hz]")
        axes.set_ylim(bottom=0.0)
        say_if_empty(axes, rows, column)
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize="small", loc="upper left")
    figure.supxlabel(
        "f from 0.7 to 1.4 Hz in 30 s and back in 30 s. Mean over environments that still stand, in windows of 1 s.",
        fontsize="small",
    )
    return figure
