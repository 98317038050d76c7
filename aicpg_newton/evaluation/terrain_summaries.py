"""From recordings on uneven terrain, and of a whole training, to rows (Fig. 5)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

from aicpg_newton.evaluation.protocols import GAITS
from aicpg_newton.evaluation.results import Row
from aicpg_newton.evaluation.summaries import Source, groups, steady_row
from aicpg_newton.evaluation.trajectories import Trajectories
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE

SAMPLE = round(0.5 * CONTROL_RATE)
"""Steps from one row of a trajectory to the next: half a second."""

SHOWN = 4
"""Environments of each group whose trajectories are kept."""

_MEASURES = (
    *("speed_mps", "symmetry_index", "balance_index", "cost_of_transport", "flight_ratio", "falls_per_minute"),
    *("survived", "turned_away", "sole_penetration_m", "sole_hover_m"),
)


def _gait(source: Source, frequency: float) -> str:
    """Gait of a condition: the controller's only one, or that of the nearest frequency [Hz]."""
    return source.gait or min(GAITS, key=lambda gait: abs(GAITS[gait] - frequency))


def terrain_rows(
    trajectories: Trajectories, frequencies: torch.Tensor, source: Source
) -> tuple[list[Row], dict[str, Any]]:
    """A row per gait on one terrain; :func:`over_terrains` makes the summary."""
    return [
        {
            **steady_row(group, frequency, source),
            "gait": _gait(source, frequency),
            "terrain_seed": source.terrain_seed,
        }
        for frequency, group in zip(frequencies.tolist(), groups(trajectories, len(frequencies)), strict=True)
    ], {}


def over_terrains(rows: list[Row]) -> dict[str, Any]:
    """Mean and standard deviation over the terrains of every measure, per gait of one controller.

    The mean of ``survived`` is the share that never fell in all.

    Args:
        rows: Its rows on all terrains; on each as many environments.
    """
    summary = []
    for gait in dict.fromkeys(row["gait"] for row in rows):
        mine = [row for row in rows if row["gait"] == gait]
        measures = {}
        for name in _MEASURES:
            values = [row[name] for row in mine if math.isfinite(row[name])]
            mean, std = (float(np.mean(values)), float(np.std(values))) if values else (None, None)
            reason = "" if values else "; ".join(sorted({row["reason"] for row in mine}))
            measures[name] = {"mean": mean, "std": std, "terrains": len(values), "reason": reason}
        summary.append({"gait": gait, "frequency_hz": mine[0]["frequency_hz"], **measures})
    return {"over_terrains": summary}


def training_rows(
    trajectories: Trajectories, frequencies: torch.Tensor, source: Source
) -> tuple[list[Row], dict[str, Any]]:
    """Ways of a few environments in their first episode, two rows a second and one where it ends.

    The place is relative to that after the first step, the velocity the mean since the row before.
    """
    rows, results = [], []
    for frequency, group in zip(frequencies.tolist(), groups(trajectories, len(frequencies)), strict=True):
        gait = {"gait": _gait(source, frequency), "iteration": source.iteration}
        for env in range(min(SHOWN, group.fallen.shape[1])):
            for point in _way(group, env):
                rows.append({**source.row(frequency), **gait, "environment": env, **point})
        standing = group.standing.sum(dim=0)
        last = standing.clamp(max=len(group.fallen) - 1)
        way = group.root_position.gather(0, last.expand(1, -1).unsqueeze(2).expand(-1, -1, 3))[0]
        distance = torch.nan_to_num(way - group.root_position[0])[:, 0]
        results.append(
            {
                **gait,
                "frequency_hz": frequency,
                "survived": float((~group.fallen.any(dim=0)).float().mean()),
                "mean_time_in_first_episode_s": float(standing.float().mean()) * CONTROL_DT,
                "mean_distance_in_first_episode_m": float(distance.mean()),
            }
        )
    return rows, {"gaits": results}


def _way(trajectories: Trajectories, env: int) -> list[Row]:
    """Rows of one environment's way."""
    position = (trajectories.root_position[:, env, :2] - trajectories.root_position[0, env, :2]).double()
    steps = len(position)
    last = min(int(trajectories.standing[:, env].sum()), steps - 1)
    points, before = [], 0
    for step in [*range(SAMPLE - 1, last, SAMPLE), last]:
        x, y = position[step].tolist()
        vx, vy = ((position[step] - position[before]) / ((step - before) * CONTROL_DT)).tolist()
        reason = ""
        if trajectories.ended[step, env]:
            turned = "turned away" if trajectories.turned[step, env] else "came to the edge of the terrain"
            reason = "fell" if trajectories.fallen[step, env] else turned
        if step == 0:
            reason += " in the first step: no velocity yet"
        points.append(
            {"time_s": (step + 1) * CONTROL_DT, "x_m": x, "y_m": y, "vx_mps": vx, "vy_mps": vy, "reason": reason}
        )
        before = step
    return points
