"""From recordings to rows: what each protocol reads off."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from aicpg_newton.evaluation import metrics
from aicpg_newton.evaluation.protocols import SPEED
from aicpg_newton.evaluation.results import Row
from aicpg_newton.evaluation.trajectories import SHORTEST, Trajectories, sole_clearance
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE

FLIGHT_THRESHOLD = 1.5 / 60
"""A window of 60 steps with a larger flight phase ratio has flight: two steps, as one may be a chance of sampling."""

TRANSITION_FROUDE = 0.5
"""Froude number of the change of gait (paper, Sec. II-C.2)."""

WINDOW = 60
"""Steps of the windows of the transition test (paper, Sec. III-B)."""

DIAGRAMS = {"walking": (2.0, 5.0), "running": (27.0, 30.0)}
"""Times of the gait diagrams [s] (Fig. 4 d, e)."""

POSES = 11
"""Number of poses in the schematic (Fig. 4 c)."""


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


def _mean(values: torch.Tensor) -> float:
    """Mean over the environments that have a value; NaN where none has."""
    return float(values[torch.isfinite(values)].mean())


def _std(values: torch.Tensor) -> float:
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
    return {
        "speed_mps": metrics.masked_mean(trajectories.speed, valid),
        "cost_of_transport": metrics.cost_of_transport(trajectories.power, trajectories.speed, valid),
        # Left limbs are compared half a stride after right ones; see the function for why.
        "symmetry_index": metrics.symmetry_index(trajectories.joint_position, valid, 0.5 * period),
        "balance_index": metrics.balance_index(trajectories.root_rotation, valid),
        "flight_ratio": metrics.flight_ratio(*strides),
        "stride_frequency_hz": CONTROL_RATE / period,
        "duty_factor": metrics.duty_factor(*strides),
        "flight_share_of_strides": metrics.flight_share_of_strides(*strides),
    }


def sole_measures(trajectories: Trajectories) -> dict[str, torch.Tensor]:
    """How deep feet in contact are in the ground and how high above it [m], each of shape [num_envs].

    All steps of the first episode count: even a robot that soon falls can be seen to sink in.
    """
    depth, hover = metrics.sole_penetration(sole_clearance(trajectories), trajectories.contact, trajectories.standing)
    return {"sole_penetration_m": depth, "sole_hover_m": hover}


def steady_row(trajectories: Trajectories, frequency: float, source: Source) -> Row:
    """All that is read off one group in steady locomotion, in the columns of any protocol."""
    measures = {name: _mean(values) for name, values in steady_measures(trajectories).items()}
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
        **{name: _mean(values) for name, values in sole_measures(trajectories).items()},
        "froude": float(metrics.froude_number(torch.tensor(speed))),
        "survived": float((~trajectories.fallen.any(dim=0)).float().mean()),
        "falls_per_minute": _mean(metrics.falls_per_minute(trajectories.fallen)),
        "reason": "; ".join(reasons),
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
    valid &= ~trajectories.fallen
    for index, frequency in enumerate(frequencies.tolist()):
        mine = trajectories.group == index
        # All steps of the group as one: an environment that falls more often has fewer steps to tell a speed from.
        speed = metrics.masked_mean(trajectories.speed[:, mine].reshape(-1, 1), valid[:, mine].reshape(-1, 1))
        rows.append(
            {
                **source.row(frequency),
                "iteration": source.iteration,
                "speed_mps": float(speed),
                "falls_per_minute": _mean(metrics.falls_per_minute(trajectories.fallen[:, mine])),
                "reason": "no environment ever walked for more than a second" if math.isnan(float(speed)) else "",
            }
        )
    return rows, {}


def transition_rows(
    trajectories: Trajectories, frequencies: torch.Tensor, source: Source
) -> tuple[list[Row], dict[str, Any]]:
    """A row per control step over the environments in their first episode, and the changes of gait."""
    settled = trajectories.settled
    speed = metrics.moving_mean(trajectories.speed, settled, WINDOW)
    flight = metrics.moving_mean((~trajectories.contact.any(dim=2)).float(), settled, WINDOW)
    standing, upright = trajectories.standing, trajectories.fallen.cumsum(dim=0) == 0
    shown = int(standing.sum(dim=0).argmax())  # the first of those that stay up longest
    rows = []
    for step in range(len(speed)):
        mean_speed, reasons = _mean(speed[step]), []
        if not standing[step].any():
            reasons.append("every environment has fallen or left the terrain")
        elif math.isnan(mean_speed):
            reasons.append("no standing environment has a full window of one second around this step")
        if not standing[step, shown]:
            reasons.append("the environment of the gait diagram has fallen or left the terrain")
        feet = trajectories.contact[step, shown].int().tolist() if standing[step, shown] else (None, None)
        rows.append(
            {
                "method": source.method,
                "seed": source.seed,
                "time_s": (step + 1) * CONTROL_DT,
                "frequency_hz": float(trajectories.frequency[step, shown]),
                "speed_mps": mean_speed,
                "speed_std_mps": _std(speed[step]),
                "froude": float(metrics.froude_number(torch.tensor(mean_speed))),
                "flight_ratio": _mean(flight[step]),
                "flight_ratio_std": _std(flight[step]),
                "standing": float(upright[step].float().mean()),
                "right_contact": feet[0],
                "left_contact": feet[1],
                "reason": "; ".join(reasons),
            }
        )
    summary = {
        **gait_changes(trajectories, speed, flight),
        "gait_diagrams": {name: _diagram(trajectories, shown, *times) for name, times in DIAGRAMS.items()},
        "poses": _poses(trajectories, shown),
    }
    return rows, summary


def gait_changes(trajectories: Trajectories, speed: torch.Tensor, flight: torch.Tensor) -> dict[str, Any]:
    """Where the Froude number passes 0.5, where flight begins and where it becomes steady.

    Each environment that got through is read off by itself; the summary is their mean and standard deviation. Flight
    begins at the first window with flight, and is steady from the last window without.

    Args:
        trajectories: The transition test.
        speed: Speed in a window around each step [m/s], shape [time, num_envs].
        flight: Flight phase ratio in such windows, shape [time, num_envs].
    """
    whole = ~trajectories.ended.any(dim=0)
    found: dict[str, list[float]] = {
        name: []
        for name in ("transition_speed_mps", "transition_frequency_hz", "flight_begins_hz", "flight_is_steady_hz")
    }
    for env in whole.nonzero().squeeze(1).tolist():
        steps = torch.isfinite(speed[:, env])
        if not steps.any():
            continue
        f, v = trajectories.frequency[steps, env], speed[steps, env]
        flying = flight[steps, env] > FLIGHT_THRESHOLD
        fast = metrics.froude_number(v) >= TRANSITION_FROUDE
        if fast.any() and not fast[0]:
            first = int(fast.long().argmax())
            found["transition_speed_mps"].append(float(v[first]))
            found["transition_frequency_hz"].append(float(f[first]))
        if flying.any():
            found["flight_begins_hz"].append(float(f[int(flying.long().argmax())]))
        if flying[-1]:
            without = (~flying).nonzero()
            found["flight_is_steady_hz"].append(float(f[int(without[-1]) + 1 if len(without) else 0]))
    reasons = {
        "transition_speed_mps": "no speed passes a Froude number of 0.5",
        "transition_frequency_hz": "no speed passes a Froude number of 0.5",
        "flight_begins_hz": "no window of a second with flight",
        "flight_is_steady_hz": "no flight in the last window",
    }
    count = int(whole.sum())
    result: dict[str, Any] = {
        "environments_that_never_fell": int((~trajectories.fallen.any(dim=0)).sum()),
        "environments_that_got_through": count,
        "environments": len(whole),
    }
    for name, values in found.items():
        reason = "" if values else reasons[name] if count else "no environment got through the 30 s without a fall"
        mean, std = (float(np.mean(values)), float(np.std(values))) if values else (None, None)
        result[name] = {"mean": mean, "std": std, "environments": len(values), "reason": reason}
    return result


def _diagram(trajectories: Trajectories, env: int, start: float, end: float) -> dict[str, Any]:
    """Strides of one environment in a stretch of time."""
    chosen = slice(round(start * CONTROL_RATE), round(end * CONTROL_RATE))
    contact, valid, joint_position = (
        each[chosen, env : env + 1]
        for each in (trajectories.contact, trajectories.standing, trajectories.joint_position)
    )
    period = metrics.stride_period(joint_position, valid)
    measures = {
        "stride_frequency_hz": CONTROL_RATE / float(period),
        "duty_factor": float(metrics.duty_factor(contact, valid, period)),
        "flight_ratio": float(metrics.flight_ratio(contact, valid, period)),
    }
    incomplete = any(math.isnan(value) for value in measures.values())
    return {"from_s": start, "to_s": end, **measures, "reason": "no whole stride of both feet" if incomplete else ""}


def _poses(trajectories: Trajectories, env: int) -> list[dict[str, Any]]:
    """Poses of one environment at even times, for the schematic of Fig. 4 (c); none after its first episode."""
    steps = np.linspace(WINDOW, len(trajectories.fallen) - 1, POSES).round().astype(int)
    return [
        {
            "time_s": (int(step) + 1) * CONTROL_DT,
            "frequency_hz": float(trajectories.frequency[step, env]),
            "height_m": float(trajectories.root_position[step, env, 2] - trajectories.ground_height[step, env]),
            "root_rotation": trajectories.root_rotation[step, env].tolist(),
            "joint_position": trajectories.joint_position[step, env].tolist(),
        }
        for step in steps
        if trajectories.standing[step, env]
    ]


def speeds_to_command(sweep: list[Row], source: Source, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Speeds to command, and the frequencies that the sweep's own curve gives for them.

    The curve is made of the frequencies at which at least half of the environments never fell, and straight between
    them. Where speed drops as frequency rises, the curve keeps the highest speed so far, so that every speed has one
    frequency, the lowest that reaches it.

    Args:
        sweep: Rows of the sweep.
        source: Whose curve.
        count: Number of speeds, evenly spread over the curve's.

    Returns:
        Speeds [m/s] and frequencies [Hz], each of shape [count], or [0] where there is no such frequency.
    """
    mine = [row for row in sweep if (row["method"], row["seed"]) == (source.method, source.seed)]
    points = sorted((row["frequency_hz"], row["speed_mps"]) for row in mine if row["survived"] >= 0.5)
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
        speed = _mean(steady_measures(group)["speed_mps"])
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
