"""From recordings to rows: what each protocol reads off."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from aicpg_newton.evaluation import intervals, metrics
from aicpg_newton.evaluation.protocols import SPEED
from aicpg_newton.evaluation.results import Row
from aicpg_newton.evaluation.trajectories import SHORTEST, Trajectories, sole_clearance
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE
from aicpg_newton.robot.locomotion import froude_number


@dataclass(frozen=True)
class Source:
    """Whose trajectories it is."""

    method: str
    seed: int
    iteration: int
    """Training iteration of the checkpoint."""
    condition: str = ""
    """What it was trained for; empty where it follows a stride frequency."""
    gait: str = ""
    """The one gait it has; empty where a stride frequency tells."""
    terrain_seed: int = 0
    """Seed of the terrain it is on, if it is not on a plane."""

    def row(self, frequency: float) -> Row:
        """The columns that name a row; the frequency [Hz] is NaN for a controller that follows none."""
        return {"method": self.method, "condition": self.condition, "frequency_hz": frequency, "seed": self.seed}


def mean(values: torch.Tensor) -> float:
    """Mean over the environments that have a value; NaN where none has."""
    return float(values[torch.isfinite(values)].mean())


def std(values: torch.Tensor) -> float:
    """Standard deviation over the environments that have a value."""
    finite = values[torch.isfinite(values)]
    return float(finite.std(correction=0)) if len(finite) else math.nan


def groups(trajectories: Trajectories, number: int) -> list[Trajectories]:
    """The trajectories of each group."""
    return [trajectories.among(trajectories.group == index) for index in range(number)]


def steady_measures(trajectories: Trajectories) -> dict[str, torch.Tensor]:
    """All measures of steady locomotion, each of shape [num_envs]; NaN where an environment did not last.

    They count the steps of the first episode after its first second, if these are a second or more.
    """
    valid = trajectories.settled
    valid = valid & (valid.sum(dim=0) >= SHORTEST)
    period = metrics.stride_period(trajectories.joint_position, valid)
    strides = trajectories.contact, valid, period
    flight = trajectories.flight, *strides
    return {
        "speed_mps": metrics.masked_mean(trajectories.speed, valid),
        "cost_of_transport": metrics.cost_of_transport(trajectories.power, trajectories.speed, valid),
        # Left limbs are compared half a stride after right ones; see the function for why.
        "symmetry_index": metrics.symmetry_index(trajectories.joint_position, valid, 0.5 * period),
        "balance_index": metrics.balance_index(trajectories.root_rotation, valid),
        "flight_ratio": metrics.flight_ratio(*flight),
        "stride_frequency_hz": CONTROL_RATE / period,
        "duty_factor": metrics.duty_factor(trajectories.support, *strides),
        "flight_share_of_strides": metrics.flight_share_of_strides(*flight),
    }


def sole_measures(trajectories: Trajectories) -> dict[str, torch.Tensor]:
    """How deep feet in contact are in the ground and how high above it [m], each of shape [num_envs].

    All steps of the first episode count: even a robot that soon falls can be seen to sink in.
    """
    depth, hover = metrics.sole_penetration(sole_clearance(trajectories), trajectories.contact, trajectories.standing)
    return {"sole_penetration_m": depth, "sole_hover_m": hover}


def falls(fallen: torch.Tensor, turned: torch.Tensor) -> Row:
    """Falls a minute and turnings away a minute of some environments, each with its certainty.

    Args:
        fallen: Where an episode ended with a fall, bool, shape [time, num_envs].
        turned: Where it ended as the robot had turned away.
    """
    minutes = len(fallen) * CONTROL_DT / 60.0
    row: Row = {"environments": fallen.shape[1]}
    for name, ended in (("falls_per_minute", fallen), ("turned_away_per_minute", turned)):
        row[name] = mean(metrics.falls_per_minute(ended))
        row[f"{name}_ci95"] = intervals.half_width_of_rate(ended.sum(dim=0).tolist(), minutes)
    return row


def steady_row(trajectories: Trajectories, frequency: float, source: Source) -> Row:
    """All that is read off one group in steady locomotion, in the columns of any protocol."""
    each = steady_measures(trajectories)
    measures = {name: mean(values) for name, values in each.items()}
    stood = ~trajectories.fallen.any(dim=0)
    low, high = intervals.of_share(int(stood.sum()), len(stood))
    speed = measures["speed_mps"]
    reasons = []
    if math.isnan(speed):
        reasons.append("every environment fell before it had walked for two seconds")
    else:
        if math.isnan(measures["cost_of_transport"]):
            reasons.append("no forward motion: no cost of transport")
        if math.isnan(measures["symmetry_index"]) or math.isnan(measures["flight_ratio"]):
            reasons.append("no whole stride: no symmetry index or flight ratio")
    return {
        **source.row(frequency),
        **measures,
        **{name: mean(values) for name, values in sole_measures(trajectories).items()},
        "froude": float(froude_number(torch.tensor(speed))),
        "survived": float(stood.float().mean()),
        "turned_away": float(trajectories.turned.any(dim=0).float().mean()),
        **falls(trajectories.fallen, trajectories.turned),
        "reason": "; ".join(reasons),
        **{f"{name}_ci95": intervals.half_width(values.tolist()) for name, values in each.items()},
        "survived_low": low,
        "survived_high": high,
    }


def sweep_rows(
    trajectories: Trajectories, frequencies: torch.Tensor, source: Source
) -> tuple[list[Row], dict[str, Any]]:
    """A row per frequency; strides and feet on the ground for the summary."""
    rows = [
        steady_row(group, frequency, source)
        for frequency, group in zip(frequencies.tolist(), groups(trajectories, len(frequencies)), strict=True)
    ]
    names = ("frequency_hz", "stride_frequency_hz", "duty_factor", "flight_share_of_strides")
    names += ("sole_penetration_m", "sole_hover_m")
    return rows, {"strides": [{name: row[name] for name in names} for row in rows]}


def disturbance_rows(
    trajectories: Trajectories, frequencies: torch.Tensor, source: Source
) -> tuple[list[Row], dict[str, Any]]:
    """Falls per minute and mean speed at each frequency, over all episodes of the minute."""
    rows = []
    valid = trajectories.age >= SHORTEST
    valid &= ~trajectories.failed
    for index, frequency in enumerate(frequencies.tolist()):
        mine = trajectories.group == index
        # All steps of the group as one: an environment that falls more often has fewer steps to tell a speed from.
        speed = metrics.masked_mean(trajectories.speed[:, mine].reshape(-1, 1), valid[:, mine].reshape(-1, 1))
        rows.append(
            {
                **source.row(frequency),
                "iteration": source.iteration,
                "speed_mps": float(speed),
                **falls(trajectories.fallen[:, mine], trajectories.turned[:, mine]),
                "reason": "no environment ever walked for more than a second" if math.isnan(float(speed)) else "",
            }
        )
    return rows, {}


def stays_on_course(row: Row) -> bool:
    """Whether at least half of a row's environments never fell and at most half turned away; unknown counts as yes."""
    return not (row.get("survived", 1.0) < 0.5 or row.get("turned_away", 0.0) > 0.5)


def speeds_to_command(sweep: list[Row], source: Source, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Speeds to command, and the frequencies that the sweep's own curve gives for them.

    The curve is made of the frequencies at which at least half of the environments never fell and at most half turned
    away, and straight between them. Where speed drops as frequency rises, the curve keeps the highest speed so far, so
    that every speed has one frequency, the lowest that reaches it.

    Args:
        sweep: Rows of the sweep.
        source: Whose curve.
        count: Number of speeds, evenly spread over the curve's.

    Returns:
        Speeds [m/s] and frequencies [Hz], each of shape [count], or [0] where there is no such frequency.
    """
    mine = [row for row in sweep if (row["method"], row["seed"]) == (source.method, source.seed)]
    known = [row for row in mine if stays_on_course(row) and math.isfinite(row["speed_mps"])]
    points = sorted((row["frequency_hz"], row["speed_mps"]) for row in known)
    if not points:
        return np.empty(0), np.empty(0)
    frequency, speed = np.array(points).T
    speed = np.maximum.accumulate(speed)
    rising = np.concatenate(([True], np.diff(speed) > 0))
    wanted = np.linspace(speed[0], speed[-1], count)
    return wanted, np.interp(wanted, speed[rising], frequency[rising])


def speed_rows(
    trajectories: Trajectories, frequencies: torch.Tensor, speeds: np.ndarray, source: Source
) -> tuple[list[Row], dict[str, Any]]:
    """A row per commanded speed, and the error over all of them."""
    rows = []
    for frequency, wanted, group in zip(
        frequencies.tolist(), speeds.tolist(), groups(trajectories, len(speeds)), strict=True
    ):
        speed = mean(steady_measures(group)["speed_mps"])
        fell = math.isnan(speed)
        rows.append(
            {
                "method": source.method,
                "seed": source.seed,
                "commanded_mps": wanted,
                "frequency_hz": frequency,
                "speed_mps": speed,
                "error_mps": speed - wanted,
                "survived": float((~group.fallen.any(dim=0)).float().mean()),
                "reason": "every environment fell before it had walked for two seconds" if fell else "",
            }
        )
    errors = np.array([row["error_mps"] for row in rows if math.isfinite(row["error_mps"])])
    reason = "" if len(errors) else "no commanded speed was walked for two seconds"
    summary = {
        "mean_absolute_error_mps": float(np.abs(errors).mean()) if len(errors) else None,
        "largest_absolute_error_mps": float(np.abs(errors).max()) if len(errors) else None,
        "reason": reason,
    }
    return rows, summary


def no_speeds(source: Source) -> tuple[list[Row], dict[str, Any]]:
    """What is left to say where the sweep gave no speed."""
    reason = "no speed to command: at every frequency of the sweep most environments fell"
    blank = dict.fromkeys(SPEED.columns)
    summary = {"mean_absolute_error_mps": None, "largest_absolute_error_mps": None, "reason": reason}
    return [{**blank, "method": source.method, "seed": source.seed, "reason": reason}], summary
