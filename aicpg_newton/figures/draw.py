"""The paper's figures from result folders, without simulating: Fig. 3 a-d, 4 a-e, 5 a-b, 6, and the speed test.

What people do is drawn in grey, from these sources:

- Metabolic cost of transport of walking, E = 29 + 0.0053 v^2 cal/kg/min with v in m/min, least near 1.23 m/s (H. J.
  Ralston, Int. Z. angew. Physiol. 17, 1958); of running, 1 kcal per kg and km at any speed (R. Margaria et al., J.
  Appl. Physiol. 18, 1963). Eq. 12 counts the mechanical work of motors, so shapes compare, heights do not.
- Change from walking to running near 2 m/s (A. Thorstensson and H. Roberthson, Acta Physiol. Scand. 131, 1987: 1.9 m/s)
  and at a Froude number of 0.4 to 0.6 (paper, Sec. II-C; R. Kram et al., J. Exp. Biol. 200, 1997: 0.5).
- A foot is on the ground for about 60 % of a walking stride, with 20 % double support (J. Perry, Gait Analysis, 1992);
  running has a flight phase and a duty factor below 0.5 (R. McN. Alexander, Int. J. Robotics Res. 3, 1984).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aicpg_newton.errors import UserError
from aicpg_newton.evaluation import results
from aicpg_newton.evaluation.protocols import (
    DISTURBANCE,
    PROTOCOLS,
    SPEED,
    SWEEP,
    TERRAIN,
    TRAINING,
    TRANSITION,
    UP_AND_DOWN,
)
from aicpg_newton.evaluation.results import Row
from aicpg_newton.evaluation.transition_summaries import FLIGHT_THRESHOLD
from aicpg_newton.figures.hysteresis import hysteresis_figure
from aicpg_newton.figures.plotting import (
    PAPERS_TRANSITION_MPS,
    REFERENCE,
    draw_points,
    mark_the_papers_transition,
    methods,
    over_seeds,
    save,
    say_if_empty,
    slug,
)
from aicpg_newton.figures.terrain import trajectories_figure, walking_and_running_figure
from aicpg_newton.figures.transition import speed_and_froude_figure, transition_figure
from aicpg_newton.files import make_folder
from aicpg_newton.robot.humanoid import GRAVITY

_TRANSITION_SPEED = 2.0  # of people [m/s]
_JOULE_PER_CALORIE = 4.184


def draw_all(folders: Sequence[Path], out: Path) -> list[Path]:
    """Draw every figure that the folders hold results for; folders share the panels.

    Args:
        folders: Folders with CSV and JSON files.
        out: Folder for the figures.

    Returns:
        The PNG files.

    Raises:
        UserError: There are no results, two folders hold the same training, or they are of different ground.
    """
    tables = {name: results.read_together(folders, name) for name in PROTOCOLS}
    details: dict[str, dict[tuple[str, int], dict]] = {name: {} for name in PROTOCOLS}
    grounds = []
    for name in tables:
        for folder in folders:
            if not (folder / f"{name}.csv").exists():
                continue
            description = results.read_description(folder, name)
            grounds.append(next((each.get("ground") for each in description["controllers"]), None))
            if not all(
                isinstance(each.get("method"), str) and isinstance(each.get("seed"), int)
                for each in description["results"]
            ):
                raise UserError(f"{folder / name}.json does not say whose results it holds; evaluate again")
            details[name] |= {(each["method"], each["seed"]): each for each in description["results"]}
    if not any(tables.values()):
        raise UserError(f"no results in {', '.join(map(str, folders))}; run a protocol into that folder first")
    if any(ground != grounds[0] for ground in grounds):
        raise UserError("the folders hold results on different ground; draw those of one ground at a time")
    try:
        return _draw(tables, details, out, uneven=grounds[0] is not None)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        where = ", ".join(map(str, folders))
        raise UserError(
            f"the results in {where} are not whole ({type(error).__name__}: {error}); evaluate again"
        ) from error


def _draw(
    tables: dict[str, list[Row]], details: dict[str, dict[tuple[str, int], dict]], out: Path, uneven: bool
) -> list[Path]:
    """Draw what there is."""
    paths = []
    if tables[SWEEP.name] or tables[DISTURBANCE.name]:
        paths.append(_save(_performance(tables[SWEEP.name], tables[DISTURBANCE.name]), out / "figure_3.png"))
    for method in methods(tables[TRANSITION.name]):
        mine = [row for row in tables[TRANSITION.name] if row["method"] == method]
        found = [each for key, each in details[TRANSITION.name].items() if key[0] == method]
        paths.append(_save(transition_figure(method, mine, found), out / f"figure_4_{slug(method)}.png"))
    if tables[TRAINING.name]:
        paths.append(_save(trajectories_figure(tables[TRAINING.name]), out / "figure_5a.png"))
    if tables[TERRAIN.name]:
        paths.append(_save(walking_and_running_figure(tables[TERRAIN.name]), out / "figure_5b.png"))
    if tables[TRANSITION.name]:
        figure = speed_and_froude_figure(tables[TRANSITION.name], uneven=uneven)
        paths.append(_save(figure, out / "figure_6.png"))
    if tables[UP_AND_DOWN.name]:
        figure = hysteresis_figure(tables[UP_AND_DOWN.name], list(details[UP_AND_DOWN.name].values()))
        paths.append(_save(figure, out / "up_and_down.png"))
    if tables[SPEED.name]:
        paths.append(_save(_commands(tables[SPEED.name]), out / "speed.png"))
    return paths


def _save(figure: Figure, path: Path) -> Path:
    make_folder(path.parent)
    return save(figure, path)


def human_walking_cost(speed: np.ndarray) -> np.ndarray:
    """Metabolic cost of transport of walking (Ralston 1958), dimensionless, of speeds [m/s]."""
    per_minute = 29.0 + 0.0053 * (60.0 * speed) ** 2  # [cal/kg/min]
    return per_minute * _JOULE_PER_CALORIE / (60.0 * speed * GRAVITY)


HUMAN_RUNNING_COST = _JOULE_PER_CALORIE / GRAVITY
"""Metabolic cost of transport of running, 1 kcal/kg/km (Margaria et al. 1963), dimensionless."""


def _performance(sweep: list[Row], disturbance: list[Row]) -> Figure:
    """Fig. 3 a-d."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    (cost, symmetry), (falls, flight) = figure.subplots(2, 2, sharex=True)
    looks = methods([*sweep, *disturbance])
    panels = (
        (cost, sweep, "cost_of_transport", "(a) cost of transport", "CoT = Σ|τω| / (m g Σv)"),
        (symmetry, sweep, "symmetry_index", "(b) symmetry index", "SI (0: symmetric)"),
        (falls, disturbance, "falls_per_minute", "(c) falls under pushes of up to ±200 N", "falls per minute"),
        (flight, sweep, "flight_ratio", "(d) flight phase ratio", "share of the gait cycle"),
    )
    for axes, rows, column, title, label in panels:
        for method, style in looks.items():
            draw_points(axes, over_seeds(rows, method, "speed_mps", column), style, method)
        axes.set(title=title, xlabel="mean speed of the centre of mass [m/s]", ylabel=label)
        say_if_empty(axes, [row for row in rows if math.isfinite(row["speed_mps"])] or rows, column)
        axes.set_ylim(bottom=0.0)
        axes.tick_params(labelbottom=True)
        axes.grid(alpha=0.3)
    walk, run = np.linspace(0.6, 2.0, 50), np.array([2.0, 4.0])
    cost.plot(walk, human_walking_cost(walk), **REFERENCE, linestyle=(0, (6, 2)), label="people walking, metabolic ¹")
    cost.plot(run, [HUMAN_RUNNING_COST] * 2, **REFERENCE, linestyle=(0, (1, 1)), label="people running, metabolic ²")
    for axes in (cost, flight):
        _mark_gait_changes(axes, sweep)
        mark_the_papers_transition(axes, *PAPERS_TRANSITION_MPS, "the paper's AI-CPG changes gait")
    flight.axvspan(_TRANSITION_SPEED - 0.1, _TRANSITION_SPEED + 0.1, color="0.85", label="people begin to run ³")
    for axes in (cost, symmetry, falls, flight):
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize="x-small", ncols=2 if axes is cost else 1)
    figure.supxlabel(
        "Curves: stride frequencies 0.70 to 1.40 Hz; single dots: controllers trained for one speed. Mean over seeds,"
        " shaded: standard deviation,\nof one seed the 95 % interval over its environments; hollow: over half of the"
        " environments fell within 20 s. People: ¹ Ralston 1958,\n² Margaria et al. 1963 (metabolic: compare the shape,"
        " not the height), ³ Thorstensson and Roberthson 1987.",
        fontsize="small",
    )
    return figure


def _mark_gait_changes(axes: Axes, sweep: list[Row]) -> None:
    """Dashed lines where walking ends and running begins of the first method that has both."""
    method = next((row["method"] for row in sweep if not row["condition"]), None)
    if method is None:
        return
    points = over_seeds(sweep, method, "speed_mps", "flight_ratio")
    stood = points.survived >= 0.5
    speed, flying = points.x[stood], points.y[stood] > FLIGHT_THRESHOLD
    if flying.any() and not flying.all():
        first, last = int(flying.argmax()), len(flying) - 1 - int((~flying)[::-1].argmax())
        ends = {0.5 * float(speed[first - 1] + speed[first])} if first else set()
        ends |= {0.5 * float(speed[last] + speed[last + 1])} if last + 1 < len(flying) else set()
        for index, end in enumerate(sorted(ends)):
            label = f"{method} changes gait" if index == 0 else None
            axes.axvline(end, color="k", linestyle="--", linewidth=1, label=label)


def _commands(rows: list[Row]) -> Figure:
    """Commanded and measured speed, and the error."""
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    speed, error = figure.subplots(1, 2)
    known = [row["commanded_mps"] for row in rows if math.isfinite(row["commanded_mps"])]
    if known:
        speed.plot([min(known), max(known)], [min(known), max(known)], **REFERENCE, label="as commanded")
    for method, style in methods(rows).items():
        for seed in sorted({row["seed"] for row in rows if row["method"] == method}):
            mine = [row for row in rows if (row["method"], row["seed"]) == (method, seed)]
            x = [row["commanded_mps"] for row in mine]
            look = {"color": style.colour, "marker": style.marker, "linestyle": style.line}
            label = f"{method}, seed {seed:g}"
            speed.plot(x, [row["speed_mps"] for row in mine], **look, label=label)
            error.plot(x, [row["error_mps"] for row in mine], **look, label=label)
    error.axhline(0.0, **REFERENCE)
    speed.set(title="speed tracked", xlabel="commanded speed [m/s]", ylabel="measured speed [m/s]")
    error.set(title="error", xlabel="commanded speed [m/s]", ylabel="measured - commanded [m/s]")
    for axes, column in ((speed, "speed_mps"), (error, "error_mps")):
        say_if_empty(axes, rows, column)
        axes.grid(alpha=0.3)
    if speed.get_legend_handles_labels()[0]:
        speed.legend(fontsize="small")
    return figure
