"""The paper's tests as data; :mod:`aicpg_newton.evaluation.run` runs any of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from aicpg_newton.env.task import Pushes
from aicpg_newton.robot.humanoid import CONTROL_RATE

FREQUENCIES = tuple(round(0.70 + 0.05 * i, 2) for i in range(15))
"""Stride frequencies 0.70 to 1.40 Hz (paper, Sec. III-A)."""

GAITS = {"walking": 0.9, "running": 1.3}
"""Stride frequencies that stand for walking and for running, near those of the imitated clips [Hz]."""

TERRAIN_SEEDS = (1001, 1002, 1003, 1004, 1005)
"""Seeds of the terrain for tests; training never uses them unless it is told to."""


def environments_for(groups: int) -> int:
    """Number of environments where none is given: 32 in each group, of which 32 say at least 89 %, but of 4 only 51 %.

    At least 64, so that protocols with few groups are no less certain.
    """
    return max(64, 32 * groups)


_Item = TypeVar("_Item")


@dataclass(frozen=True)
class Protocol:
    """What is done to a controller; what is read off is in :mod:`aicpg_newton.evaluation.summaries`."""

    name: str
    duration: float
    """Simulated time [s]."""
    frequencies: tuple[float, ...]
    """Stride frequency at the start [Hz], one per group; the environments are shared out evenly among them."""
    columns: tuple[str, ...]
    """Columns of the CSV file; ``reason`` says why a cell is empty."""
    ramp: float = 0.0
    """Rise of every stride frequency [Hz/s]."""
    turns_back: bool = False
    """Whether it falls again, as fast, from the middle of the time on."""
    push_force: float = 0.0
    """Largest force on the torso along each world axis [N]."""
    push_duration: float = 0.1
    """Duration of a push [s]."""
    push_interval: float = 1.0
    """Time from push to push [s]."""
    checkpoints: int = 1
    """How many of a run folder's checkpoints are tested: the last ones."""
    whole_training: bool = False
    """Whether the checkpoints are spread evenly over the training instead."""
    every_terrain: bool = False
    """Whether it is done on the terrain of every seed; other protocols use the first."""
    intervals: tuple[str, ...] = ()
    """Columns whose certainty has columns as well; see :meth:`further_columns`."""
    commanded_speeds: int = 0
    """Number of speeds to command in place of ``frequencies``, evenly spread over those of the seed's own sweep."""

    @property
    def steps(self) -> int:
        """Control steps."""
        return round(self.duration * CONTROL_RATE)

    @property
    def groups(self) -> int:
        """Number of groups the environments are shared out among."""
        return self.commanded_speeds or len(self.frequencies)

    @property
    def further_columns(self) -> tuple[str, ...]:
        """How many environments a row is from, the 95 % interval over them of each measure, and who turned away.

        ``survived`` has the interval's ends, the others half its width. Results of earlier versions lack some of these
        columns.
        """
        if not self.intervals:
            return ()
        halves = (f"{name}_ci95" for name in self.intervals if name != "survived")
        ends = ("survived_low", "survived_high") if "survived" in self.intervals else ()
        turned = ("turned_away_per_minute", "turned_away_per_minute_ci95")
        share = ("turned_away",) if ends else ()
        return ("environments", *halves, *ends, *share, *turned)

    @property
    def turns_the_frequency(self) -> bool:
        """Whether it asks for another speed by another stride frequency, so that others cannot take part."""
        return bool(self.ramp or self.commanded_speeds)

    def pushes(self) -> Pushes:
        """The pushes as a task's settings."""
        return Pushes(force=self.push_force, duration=self.push_duration, interval=self.push_interval)

    def pick(self, files: list[_Item]) -> list[_Item]:
        """Those of a run's checkpoints, oldest first, that are tested."""
        if not self.whole_training:
            return files[-self.checkpoints :]
        even = np.linspace(0, len(files) - 1, min(self.checkpoints, len(files)))
        return [files[index] for index in even.round().astype(int)]


_STEADY = ("speed_mps", "cost_of_transport", "symmetry_index", "flight_ratio", "falls_per_minute", "survived")

SWEEP = Protocol(
    name="sweep",
    duration=20.0,
    frequencies=FREQUENCIES,
    columns=(
        *("method", "condition", "frequency_hz", "seed", "speed_mps", "cost_of_transport", "symmetry_index"),
        *("balance_index", "froude", "flight_ratio", "survived", "falls_per_minute", "reason"),
    ),
    intervals=_STEADY,
)
"""Measures of steady locomotion at each frequency (Fig. 3 a, b, d)."""

DISTURBANCE = Protocol(
    name="disturbance",
    duration=60.0,
    frequencies=FREQUENCIES,
    columns=("method", "condition", "frequency_hz", "seed", "iteration", "speed_mps", "falls_per_minute", "reason"),
    intervals=("falls_per_minute",),
    push_force=200.0,
    checkpoints=5,
)
"""Falls per minute under pushes of up to 200 N on every axis for 0.1 s in every second (Fig. 3 c)."""

TRANSITION = Protocol(
    name="transition",
    duration=30.0,
    frequencies=(0.7,),
    columns=(
        *("method", "seed", "time_s", "frequency_hz", "speed_mps", "speed_std_mps", "froude", "flight_ratio"),
        *("flight_ratio_std", "standing", "right_contact", "left_contact", "reason"),
    ),
    ramp=0.023,
)
"""From walking to running with f(t) = 0.7 + 0.023 t (Fig. 4 and 6)."""

SLOWING = replace(TRANSITION, name="slowing", frequencies=(1.39,), ramp=-TRANSITION.ramp)
"""The same the other way: from running to walking."""

UP_AND_DOWN = replace(TRANSITION, name="up_and_down", duration=60.0, ramp=0.7 / 30.0, turns_back=True)
"""From 0.7 Hz to 1.4 Hz in 30 s, and back in 30 s: does the gait change at the same speed both ways?"""

SPEED = Protocol(
    name="speed",
    duration=20.0,
    frequencies=(),
    columns=("method", "seed", "commanded_mps", "frequency_hz", "speed_mps", "error_mps", "survived", "reason"),
    commanded_speeds=8,
)
"""A speed is turned into a frequency by the sweep's curve and then walked or run: how far off is it?"""

TERRAIN = Protocol(
    name="terrain",
    duration=20.0,
    frequencies=tuple(GAITS.values()),
    columns=(
        *("method", "condition", "gait", "frequency_hz", "seed", "terrain_seed", "speed_mps", "symmetry_index"),
        *("balance_index", "cost_of_transport", "flight_ratio", "survived", "falls_per_minute"),
        *("sole_penetration_m", "sole_hover_m", "reason"),
    ),
    intervals=_STEADY,
    every_terrain=True,
)
"""Walking and running on terrain that the controller has never seen (Fig. 5 b)."""

TRAINING = Protocol(
    name="training",
    duration=10.0,
    frequencies=tuple(GAITS.values()),
    columns=(
        *("method", "condition", "gait", "frequency_hz", "seed", "iteration", "environment"),
        *("time_s", "x_m", "y_m", "vx_mps", "vy_mps", "reason"),
    ),
    checkpoints=12,
    whole_training=True,
)
"""Where robots go that are controlled by the checkpoints of a training, from its first to its last (Fig. 5 a)."""

_ALL = (SWEEP, DISTURBANCE, TRANSITION, SLOWING, UP_AND_DOWN, SPEED, TERRAIN, TRAINING)

PROTOCOLS = {protocol.name: protocol for protocol in _ALL}
"""In the order in which they are run; ``speed`` needs the sweep."""
