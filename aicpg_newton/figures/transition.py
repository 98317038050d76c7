"""Figures of the transition test: Fig. 4 a-e and Fig. 6; sources of human references in :mod:`.figures`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aicpg_newton.evaluation.results import Row
from aicpg_newton.evaluation.transition_summaries import DIAGRAMS, POSES, TRANSITION_FROUDE
from aicpg_newton.figures.plotting import (
    PAPERS_TRANSITION_HZ,
    REFERENCE,
    Style,
    curves_over_time,
    mark_the_papers_transition,
    mean,
    methods,
    of_how_many,
    say_if_empty,
)
from aicpg_newton.motion.figure import draw_stick_figures
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import CONTROL_DT

_HUMAN_FROUDE = (0.4, 0.6)
_CHANGES = {
    "transition_frequency_hz": ("Fr = 0.5", ":"),
    "flight_begins_hz": ("flight begins", "--"),
    "flight_is_steady_hz": ("flight is steady", "-."),
}


def transition_figure(method: str, rows: list[Row], found: list[dict[str, Any]]) -> Figure:
    """Fig. 4 of one method.

    Args:
        method: Its name.
        rows: Its rows of ``transition.csv``, of all seeds.
        found: Its entries of ``results`` in ``transition.json``; the first seed is the one shown in c to e.
    """
    figure = Figure(figsize=(12, 15), layout="constrained")
    grid = figure.add_gridspec(8, 2, height_ratios=(0.8, 1, 1, 1, 0.7, 0.5, 1.3, 0.8))
    style = next(iter(methods(rows).values()))
    curves = curves_over_time(rows)
    signal = figure.add_subplot(grid[0, :])
    time, frequency = curves["time_s"][0], curves["frequency_hz"][0]
    phase = 2 * math.pi * np.cumsum(frequency * np.gradient(time))
    signal.plot(time, np.sin(phase), color="k", linewidth=0.9)
    signal.set(title=f"(a) {method}: input of the rhythm generator", ylabel="sin φ", xlim=(0, time[-1]))
    panels = (
        ("speed_mps", "(b) speed of the centre of mass", "speed [m/s]"),
        ("froude", "Froude number", "Fr"),
        ("flight_ratio", "flight phase ratio", "in 60 steps"),
        ("frequency_hz", "stride frequency", "f [Hz]"),
        ("standing", "environments that have not fallen yet", "share"),
    )
    for index, (column, title, label) in enumerate(panels):
        axes = figure.add_subplot(grid[1 + index, :])
        _draw_curve(axes, curves, column, style, method)
        axes.set(ylabel=label, xlim=(0, time[-1]))
        axes.set_title(title, loc="left" if index else "center", fontsize="medium" if index else None)
        axes.grid(alpha=0.3)
        if column == "froude":
            axes.axhspan(*_HUMAN_FROUDE, color="0.85", label="people begin to run: Fr 0.4 to 0.6 (Kram et al. 1997)")
            axes.set_ylim(bottom=0.0)
        if column == "standing":
            axes.set_ylim(-0.05, 1.05)
        if column == "flight_ratio":
            start, end = np.interp(PAPERS_TRANSITION_HZ, frequency, time)
            told = "the paper's change of gait, {:g} to {:g} Hz".format(*PAPERS_TRANSITION_HZ)
            mark_the_papers_transition(axes, float(start), float(end), told)
        _draw_changes(axes, found, curves, with_label=index == 0)
        say_if_empty(axes, rows, column)
        if column in ("speed_mps", "froude", "flight_ratio"):
            axes.legend(fontsize="small", loc="upper left")
        if index == len(panels) - 1:
            axes.set_xlabel("time [s]")
    _draw_poses(figure.add_subplot(grid[6, :]), found[0]["poses"])
    shown = [row for row in rows if row["seed"] == found[0]["seed"]]
    for column, (letter, (gait, times)) in enumerate(zip("de", DIAGRAMS.items(), strict=True)):
        axes = figure.add_subplot(grid[7, column])
        _draw_diagram(axes, shown, *times, f"({letter}) {_sentence(found[0]['gait_diagrams'][gait])}")
    figure.supxlabel(
        "(b): mean over environments that still stand, in windows of 1 s; band: standard deviation over seeds, or over"
        " the environments of a single seed.\n(d, e): when a foot is on the ground, and when neither is (flight)."
        " People: 60 % of a walking stride, 20 % of it on both feet (Perry 1992);\nless than half of a running stride,"
        " with flight (Alexander 1984).",
        fontsize="small",
    )
    return figure


def speed_and_froude_figure(rows: list[Row], uneven: bool) -> Figure:
    """Fig. 6: speed and Froude number over time, all methods; the title says whether the ground was uneven."""
    figure = Figure(figsize=(10, 6), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    for method, style in methods(rows).items():
        curves = curves_over_time([row for row in rows if row["method"] == method])
        lasted = curves["standing"][0][-1]
        label = f"{method} ({lasted:.0%} never fell)" if math.isfinite(lasted) else method
        _draw_curve(top, curves, "speed_mps", style, label)
        _draw_curve(bottom, curves, "froude", style, method)
    bottom.axhspan(*_HUMAN_FROUDE, color="0.85", label="people begin to run: Fr 0.4 to 0.6 (Kram et al. 1997)")
    bottom.axhline(TRANSITION_FROUDE, **REFERENCE, linestyle=":")
    where = "uneven terrain" if uneven else "flat ground"
    top.set(title=f"From walking to running on {where}, f(t) = 0.7 Hz + 0.023 Hz/s t", ylabel="speed [m/s]")
    bottom.set(xlabel="time [s]", ylabel="Froude number")
    for axes, column in ((top, "speed_mps"), (bottom, "froude")):
        say_if_empty(axes, rows, column)
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small", loc="upper left")
    return figure


def _draw_curve(axes: Axes, curves: dict, column: str, style: Style, label: str) -> None:
    """Mean over time with a band of one standard deviation."""
    time, (value, spread) = curves["time_s"][0], curves[column]
    axes.plot(time, value, color=style.colour, linestyle=style.line, label=label)
    axes.fill_between(time, value - spread, value + spread, color=style.colour, alpha=0.2, linewidth=0)


def _draw_changes(axes: Axes, found: list[dict[str, Any]], curves: dict, with_label: bool) -> None:
    """Lines where the gait changes, as the mean over seeds."""
    time, frequency = curves["time_s"][0], curves["frequency_hz"][0]
    for name, (label, line) in _CHANGES.items():
        changes = [math.nan if each[name]["mean"] is None else each[name]["mean"] for each in found]
        f = mean(changes)
        if math.isfinite(f):
            text = f"{label}: {f:.2f} Hz {of_how_many(changes)}".rstrip() if with_label else None
            axes.axvline(float(np.interp(f, frequency, time)), color="k", linestyle=line, linewidth=1, label=text)


def _draw_poses(axes: Axes, poses: list[dict[str, Any]]) -> None:
    """Fig. 4 c: poses at even times."""
    axes.set(title="(c) poses of the first environment that stayed up longest; right limbs dark", yticks=[])
    if not poses:
        axes.set(xticks=[])
        axes.text(
            0.5, 0.5, "no poses: its first episode ended in the first second", ha="center", transform=axes.transAxes
        )
        return
    x = 0.95 * torch.arange(len(poses))
    height = torch.tensor([pose["height_m"] for pose in poses])
    rotation = torch.tensor([pose["root_rotation"] for pose in poses])
    draw_stick_figures(
        axes,
        torch.stack((x, torch.zeros_like(x), height), dim=1),
        rotations.normalised(rotation, rotation.new_tensor((0.0, 0.0, 0.0, 1.0))),
        torch.tensor([pose["joint_position"] for pose in poses]),
    )
    axes.set_xticks(x.tolist(), [f"{pose['time_s']:.1f} s\n{pose['frequency_hz']:.2f} Hz" for pose in poses])
    axes.set(xlim=(-0.6, 0.95 * (POSES - 1) + 0.6), ylim=(-0.08, 1.75))
    if len(poses) < POSES:
        axes.text(0.95 * len(poses), 0.8, "then it fell or left the terrain", ha="center")


def _draw_diagram(axes: Axes, rows: list[Row], start: float, end: float, title: str) -> None:
    """Fig. 4 d and e: when each foot is on the ground."""
    chosen = [row for row in rows if start <= row["time_s"] <= end]
    time = np.array([row["time_s"] for row in chosen])
    feet = np.array([[row["right_contact"], row["left_contact"]] for row in chosen]).reshape(-1, 2)
    known = np.isfinite(feet).all(axis=1)
    flight = known & ~(feet > 0).any(axis=1)
    for height, (on, colour) in enumerate(((flight, "k"), (feet[:, 0] > 0, "0.25"), (feet[:, 1] > 0, "0.65"))):
        # From where it changes to where it changes back; a row stands for the control step that ends at its time.
        edges = np.flatnonzero(np.diff(np.concatenate(([0], (on & known).astype(int), [0]))))
        spans = [
            (float(time[i]) - CONTROL_DT, float(time[j - 1] - time[i]) + CONTROL_DT)
            for i, j in edges.reshape(-1, 2).tolist()
        ]
        axes.broken_barh(spans, (height - 0.35, 0.7), facecolors=colour, linewidth=0)
    axes.set_title(title, fontsize="medium")
    axes.set(xlim=(start, end), ylim=(-0.6, 2.6), xlabel="time [s]")
    axes.set_yticks([0, 1, 2], ["flight", "right", "left"])
    if not known.any():
        axes.text(0.5, 0.5, "it had fallen or left before", ha="center", transform=axes.transAxes)


def _sentence(diagram: dict[str, Any]) -> str:
    """What a gait diagram shows, in numbers."""
    span = f"{diagram['from_s']:g} to {diagram['to_s']:g} s"
    if diagram["reason"]:
        return f"{span}: {diagram['reason']}"
    return (
        f"{span}: {diagram['stride_frequency_hz']:.2f} strides/s, duty factor {diagram['duty_factor']:.2f},"
        f" flight {diagram['flight_ratio']:.2f}"
    )
