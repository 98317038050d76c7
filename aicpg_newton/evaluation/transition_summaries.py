"""From trajectories in which the stride frequency is turned to rows and changes of gait (Fig. 4 and 6)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

from aicpg_newton.evaluation import metrics
from aicpg_newton.evaluation.results import Row
from aicpg_newton.evaluation.summaries import Source, mean, std
from aicpg_newton.evaluation.trajectories import Trajectories
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE
from aicpg_newton.robot.locomotion import froude_number

FLIGHT_THRESHOLD = 1.5 / 60
"""A window of 60 steps with a larger flight phase ratio has flight: 25 ms in a second."""

TRANSITION_FROUDE = 0.5
"""Froude number of the change of gait (paper, Sec. II-C.2)."""

WINDOW = 60
"""Steps of the windows of the transition test (paper, Sec. III-B)."""

DIAGRAMS = {"walking": (2.0, 5.0), "running": (27.0, 30.0)}
"""Times of the gait diagrams [s] (Fig. 4 d, e)."""

POSES = 11
"""Number of poses in the schematic (Fig. 4 c)."""


def transition_rows(
    trajectories: Trajectories, frequencies: torch.Tensor, source: Source
) -> tuple[list[Row], dict[str, Any]]:
    """A row per control step over the environments in their first episode, the changes of gait, and pictures."""
    rows, speed, flight, shown = _rows(trajectories, source)
    summary = {
        **_survivors(trajectories),
        **gait_changes(trajectories.frequency, speed, flight, _whole(trajectories)),
        "gait_diagrams": {name: _diagram(trajectories, shown, *times) for name, times in DIAGRAMS.items()},
        "poses": _poses(trajectories, shown),
    }
    return rows, summary


def slowing_rows(
    trajectories: Trajectories, frequencies: torch.Tensor, source: Source
) -> tuple[list[Row], dict[str, Any]]:
    """The same from running to walking; changes of gait are read off in the direction of rising frequency."""
    rows, speed, flight, _ = _rows(trajectories, source)
    changes = gait_changes(trajectories.frequency.flip(0), speed.flip(0), flight.flip(0), _whole(trajectories))
    return rows, {**_survivors(trajectories), **changes}


def up_and_down_rows(
    trajectories: Trajectories, frequencies: torch.Tensor, source: Source
) -> tuple[list[Row], dict[str, Any]]:
    """The same up and then down again; the changes of gait of each way, and by how much they differ (hysteresis)."""
    rows, speed, flight, _ = _rows(trajectories, source)
    half, whole, frequency = len(speed) // 2, _whole(trajectories), trajectories.frequency
    up = gait_changes(frequency[:half], speed[:half], flight[:half], whole)
    down = gait_changes(frequency[half:].flip(0), speed[half:].flip(0), flight[half:].flip(0), whole)
    known = [way["transition_frequency_hz"]["mean"] for way in (up, down)]
    hysteresis = None if None in known else known[0] - known[1]
    return rows, {**_survivors(trajectories), "up": up, "down": down, "hysteresis_hz": hysteresis}


def _rows(trajectories: Trajectories, source: Source) -> tuple[list[Row], torch.Tensor, torch.Tensor, int]:
    """A row per control step; speed [m/s] and flight ratio in windows, each [time, num_envs]; who is shown."""
    settled = trajectories.settled
    speed = metrics.moving_mean(trajectories.speed, settled, WINDOW)
    flight = metrics.moving_mean(trajectories.flight, settled, WINDOW)
    standing, upright = trajectories.standing, trajectories.failed.cumsum(dim=0) == 0
    shown = int(standing.sum(dim=0).argmax())  # the first of those that stay up longest
    rows = []
    for step in range(len(speed)):
        mean_speed, reasons = mean(speed[step]), []
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
                "speed_std_mps": std(speed[step]),
                "froude": float(froude_number(torch.tensor(mean_speed))),
                "flight_ratio": mean(flight[step]),
                "flight_ratio_std": std(flight[step]),
                "standing": float(upright[step].float().mean()),
                "right_contact": feet[0],
                "left_contact": feet[1],
                "reason": "; ".join(reasons),
            }
        )
    return rows, speed, flight, shown


def gait_changes(
    frequency: torch.Tensor, speed: torch.Tensor, flight: torch.Tensor, whole: torch.Tensor
) -> dict[str, Any]:
    """Where the Froude number passes 0.5, where flight begins and where it becomes steady.

    Each environment that got through is read off by itself; the summary is their mean and standard deviation. Flight
    begins at the first window with flight, and is steady from the last window without.

    Args:
        frequency: Stride frequency, which rises [Hz], shape [time, num_envs].
        speed: Speed in a window around each step [m/s], shape [time, num_envs].
        flight: Flight phase ratio in such windows, shape [time, num_envs].
        whole: Environments that got through, bool, shape [num_envs].
    """
    found: dict[str, list[float]] = {
        name: []
        for name in ("transition_speed_mps", "transition_frequency_hz", "flight_begins_hz", "flight_is_steady_hz")
    }
    for env in whole.nonzero().squeeze(1).tolist():
        steps = torch.isfinite(speed[:, env])
        if not steps.any():
            continue
        f, v = frequency[steps, env], speed[steps, env]
        flying = flight[steps, env] > FLIGHT_THRESHOLD
        fast = froude_number(v) >= TRANSITION_FROUDE
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
    result: dict[str, Any] = {}
    for name, values in found.items():
        reason = "" if values else reasons[name] if count else "no environment got through without a fall"
        middle, spread = (float(np.mean(values)), float(np.std(values))) if values else (None, None)
        result[name] = {"mean": middle, "std": spread, "environments": len(values), "reason": reason}
    return result


def _whole(trajectories: Trajectories) -> torch.Tensor:
    """Environments whose first episode lasted to the end, bool, shape [num_envs]."""
    return ~trajectories.ended.any(dim=0)


def _survivors(trajectories: Trajectories) -> dict[str, int]:
    """How many environments never fell, never turned away, and got through: did not leave the terrain either."""
    return {
        "environments_that_never_fell": int((~trajectories.fallen.any(dim=0)).sum()),
        "environments_that_never_turned_away": int((~trajectories.turned.any(dim=0)).sum()),
        "environments_that_got_through": int(_whole(trajectories).sum()),
        "environments": trajectories.fallen.shape[1],
    }


def _diagram(trajectories: Trajectories, env: int, start: float, end: float) -> dict[str, Any]:
    """Strides of one environment in a stretch of time."""
    chosen = slice(round(start * CONTROL_RATE), round(end * CONTROL_RATE))
    contact, valid, joint_position = (
        each[chosen, env : env + 1]
        for each in (trajectories.contact, trajectories.standing, trajectories.joint_position)
    )
    support, flight = (each[chosen, env : env + 1] for each in (trajectories.support, trajectories.flight))
    period = metrics.stride_period(joint_position, valid)
    measures = {
        "stride_frequency_hz": CONTROL_RATE / float(period),
        "duty_factor": float(metrics.duty_factor(support, contact, valid, period)),
        "flight_ratio": float(metrics.flight_ratio(flight, contact, valid, period)),
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
