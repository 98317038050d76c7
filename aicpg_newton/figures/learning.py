"""Learning curves: from the logs of runs to a table, and from the table to a figure."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator, ScalarEvent

from aicpg_newton.env.methods import condition, get_method
from aicpg_newton.env.registry import task_from_dict
from aicpg_newton.errors import UserError
from aicpg_newton.evaluation.results import Row
from aicpg_newton.figures.plotting import STYLES
from aicpg_newton.learning import checkpoint
from aicpg_newton.robot.humanoid import CONTROL_DT
from aicpg_newton.texts import number, read_text

CURVES = {
    "episode_s": ("Train/mean_episode_length", CONTROL_DT, "length of an episode [s]"),
    "episode_reward": ("Train/mean_reward", 1.0, "reward of an episode"),
    "slow_mps": ("Speed/lowest_third_of_f", 1.0, "speed, lowest third of f [m/s]"),
    "fast_mps": ("Speed/highest_third_of_f", 1.0, "speed, highest third of f [m/s]"),
}
"""Columns of the table: name in the log, its unit in that of the column, and title of the panel."""

_TEXT = ("task", "method", "condition")
COLUMNS = (*_TEXT, "seed", "iteration", "samples", *CURVES)
"""What the table holds, a row for each stretch of a run; iteration and samples are those at its end."""


def read_run(folder: Path, points: int) -> list[Row]:
    """The curves of a training, as means over stretches of equal length.

    Args:
        folder: Run folder with checkpoints and a log.
        points: Number of stretches, at most.

    Raises:
        UserError: The folder holds no checkpoint or no log.
    """
    if not folder.is_dir():
        raise UserError(f"no run folder at {folder}; give the folder of a training")
    content = checkpoint.read(folder)
    checkpoint.require_run(content, folder)
    task = task_from_dict(content["task"], str(folder))
    log = EventAccumulator(str(folder), size_guidance={"scalars": 0})
    log.Reload()
    missing = [name for name, _, _ in CURVES.values() if name not in log.Tags()["scalars"]]
    if missing or not content["iteration"]:
        raise UserError(
            f"{folder} holds no log of {missing[0] if missing else 'an iteration'}; give a run that was logged"
        )
    values = {name: _by_step(log.Scalars(tag)) for name, (tag, _, _) in CURVES.items()}
    steps = sorted(set.intersection(*(set(each) for each in values.values())))
    each = content["samples"] / content["iteration"]
    rows = []
    for stretch in np.array_split(np.array(steps), min(points, len(steps))):
        told = {"task": task.name, "method": get_method(task.method).title, "condition": condition(task)}
        iteration = int(stretch[-1]) + 1
        means = {
            name: unit * float(np.mean([values[name][step] for step in stretch]))
            for name, (_, unit, _) in CURVES.items()
        }
        place = {"seed": content["run"]["seed"], "iteration": iteration, "samples": round(iteration * each)}
        rows.append({**told, **place, **means})
    return rows


def _by_step(events: Iterable[ScalarEvent]) -> dict[int, float]:
    """Values by iteration; of one that was done again after a resume the later."""
    return {event.step: event.value for event in sorted(events, key=lambda event: event.wall_time)}


def as_csv(rows: Iterable[Row]) -> str:
    """The table as text, numbers with six digits."""
    table = io.StringIO(newline="")
    writer = csv.DictWriter(table, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({name: f"{each:.6g}" if isinstance(each, float) else each for name, each in row.items()})
    return table.getvalue()


def read_table(path: Path) -> list[Row]:
    """Rows of :func:`as_csv`.

    Raises:
        UserError: There is no such file, or it holds something else.
    """
    if not path.is_file():
        raise UserError(f"there is no {path}; make it from run folders with --runs")
    try:
        reader = csv.DictReader(io.StringIO(read_text(path), newline=""), strict=True)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise ValueError("other columns")
        return [{name: text if name in _TEXT else number(text) for name, text in row.items()} for row in reader]
    except (csv.Error, ValueError, TypeError) as error:
        raise UserError(f"{path} is no table of learning curves ({error}); make it anew from run folders") from error


def refuse_twins(rows: Iterable[Row]) -> None:
    """Refuse two trainings that nobody could tell apart.

    Raises:
        UserError: They have the same task, method, condition and seed.
    """
    seen: set[tuple] = set()
    for row in rows:
        key = (*(row[name] for name in _TEXT), row["seed"], row["iteration"])
        if key in seen:
            raise UserError(f"two runs are {_title(row)}, seed {row['seed']:g}; give one of them")
        seen.add(key)


def _title(row: Row) -> str:
    return " ".join(text for text in (row["method"], row["condition"], f"({row['task']})") if text)


def draw(rows: Sequence[Row]) -> Figure:
    """A panel for each curve over samples: thin each seed, thick the mean as far as all seeds have come."""
    figure = Figure(figsize=(12, 8), layout="constrained")
    groups: dict[str, dict[float, list[Row]]] = {}
    for row in rows:
        groups.setdefault(_title(row), {}).setdefault(row["seed"], []).append(row)
    for axes, (name, (_, _, title)) in zip(figure.subplots(2, 2, sharex=True).flat, CURVES.items(), strict=True):
        for style, (label, seeds) in zip(cycle(STYLES), groups.items(), strict=False):
            lines = [([row["samples"] / 1e6 for row in run], [row[name] for row in run]) for run in seeds.values()]
            for x, y in lines:
                axes.plot(x, y, color=style.colour, linewidth=0.8, alpha=0.5 if len(lines) > 1 else 1.0)
            common = np.linspace(max(x[0] for x, _ in lines), min(x[-1] for x, _ in lines), 200)
            mean = np.mean([np.interp(common, x, y) for x, y in lines], axis=0)
            number_of = f"{len(lines)} seed{'s' if len(lines) > 1 else ''}"
            axes.plot(common, mean, color=style.colour, linewidth=2.0, label=f"{label}, {number_of}")
        axes.set(title=title, ylim=(0.0, None))
        axes.grid(alpha=0.3)
        axes.tick_params(labelbottom=True)
    figure.axes[0].legend(fontsize="small")
    figure.supxlabel("samples (control steps of one robot) [million]", fontsize="medium")
    return figure
