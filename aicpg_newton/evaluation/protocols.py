"""The paper's tests as data; :mod:`aicpg_newton.evaluation.run` runs any of them."""

from __future__ import annotations

from dataclasses import dataclass

from aicpg_newton.cpg import CONTROL_RATE
from aicpg_newton.task import Pushes

FREQUENCIES = tuple(round(0.70 + 0.05 * i, 2) for i in range(15))
"""Stride frequencies 0.70 to 1.40 Hz (paper, Sec. III-A)."""


@dataclass(frozen=True)
class Protocol:
    """What is done to a controller; what is read off is in :mod:`aicpg_newton.evaluation.summaries`."""

    name: str
    duration: float
    """Simulated time [s]."""
    frequencies: tuple[float, ...]
    """Stride frequency at the start [Hz], one per condition; the environments are shared out evenly among them."""
    columns: tuple[str, ...]
    """Columns of the CSV file; ``reason`` says why a cell is empty."""
    ramp: float = 0.0
    """Rise of every stride frequency [Hz/s]."""
    push_force: float = 0.0
    """Largest force on the torso along each world axis [N]."""
    push_duration: float = 0.1
    """Duration of a push [s]."""
    push_interval: float = 1.0
    """Time from push to push [s]."""
    checkpoints: int = 1
    """How many of a run folder's last checkpoints are tested."""
    commanded_speeds: int = 0
    """Number of speeds to command in place of ``frequencies``, evenly spread over those of the seed's own sweep."""

    @property
    def steps(self) -> int:
        """Control steps."""
        return round(self.duration * CONTROL_RATE)

    @property
    def conditions(self) -> int:
        """Number of groups the environments are shared out among."""
        return self.commanded_speeds or len(self.frequencies)

    def pushes(self) -> Pushes:
        """The pushes as a task's settings."""
        return Pushes(force=self.push_force, duration=self.push_duration, interval=self.push_interval)


SWEEP = Protocol(
    name="sweep",
    duration=20.0,
    frequencies=FREQUENCIES,
    columns=(
        *("method", "frequency_hz", "seed", "speed_mps", "cost_of_transport", "symmetry_index", "balance_index"),
        *("froude", "flight_ratio", "survived", "falls_per_minute", "reason"),
    ),
)
"""Measures of steady locomotion at each frequency (Fig. 3 a, b, d)."""

DISTURBANCE = Protocol(
    name="disturbance",
    duration=60.0,
    frequencies=FREQUENCIES,
    columns=("method", "frequency_hz", "seed", "iteration", "speed_mps", "falls_per_minute", "reason"),
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

COMMAND = Protocol(
    name="command",
    duration=20.0,
    frequencies=(),
    columns=("method", "seed", "commanded_mps", "frequency_hz", "speed_mps", "error_mps", "survived", "reason"),
    commanded_speeds=8,
)
"""A speed is turned into a frequency by the sweep's curve and then walked or run: how far off is it?"""

PROTOCOLS = {protocol.name: protocol for protocol in (SWEEP, DISTURBANCE, TRANSITION, COMMAND)}
"""In the order in which ``all`` runs them; ``command`` needs the sweep."""
