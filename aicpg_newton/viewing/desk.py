"""The desk of whoever watches: what can be asked of the robots, and what is read off them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue

DIRECTIONS = {
    "forwards": (1.0, 0.0, 0.0),
    "backwards": (-1.0, 0.0, 0.0),
    "to the left": (0.0, 1.0, 0.0),
    "to the right": (0.0, -1.0, 0.0),
}
"""Directions of a push as unit vectors of the world; robots go along x."""


@dataclass(frozen=True)
class Turn:
    """Go over to another stride frequency."""

    frequency: float
    """Stride frequency [Hz]."""
    robot: int | None = None
    """Which robot; None for all. The same below."""


@dataclass(frozen=True)
class Ramp:
    """Slowly up from walking to running, and down again."""

    robot: int | None = None


@dataclass(frozen=True)
class Push:
    """A push on the torso."""

    direction: str
    """One of :data:`DIRECTIONS`."""
    force: float
    """Its strength [N]."""
    robot: int | None = None


@dataclass(frozen=True)
class Restart:
    """All robots begin anew."""


@dataclass(frozen=True)
class ChangeGround:
    """All robots begin anew on other ground."""

    ground: str
    """One of :attr:`Desk.grounds`."""


Wish = Turn | Ramp | Push | Restart | ChangeGround


@dataclass(frozen=True)
class Readings:
    """What is shown of the robots in one control step, an entry for each robot."""

    time: float
    """Simulated time [s]."""
    frequency: list[float]
    """Stride frequency f [Hz]."""
    phase: list[float]
    """Phase of the rhythm generator [rad]."""
    speed: list[float]
    """Forward speed, mean over the last second [m/s]."""
    froude: list[float]
    """Froude number of that speed."""
    contact: list[tuple[bool, bool]]
    """Whether the right and the left foot are on the ground."""
    falls: list[int]
    """Falls so far, turnings away not counted."""
    pushed: tuple[float, Push] | None = None
    """The last push and when it began [s]; None before the first."""


@dataclass
class Desk:
    """Wishes go one way, readings the other; viewers may ask from threads of their own."""

    frequencies: list[float]
    """Stride frequency of each robot at the start [Hz]; empty where none does anything."""
    lowest: float = 0.0
    """Least stride frequency that can be asked for [Hz]."""
    highest: float = 0.0
    """Greatest stride frequency that can be asked for [Hz]."""
    grounds: tuple[str, ...] = ()
    """Names of the grounds to choose from; none where the ground stays."""
    ground: str = ""
    """The one that the robots are on."""
    num_robots: int = 1
    """Number of robots that can be watched."""
    _wishes: SimpleQueue[Wish] = field(default_factory=SimpleQueue)

    def ask(self, wish: Wish) -> None:
        """Ask for something; it is done after the control step that is under way."""
        self._wishes.put(wish)

    def asked(self) -> Iterator[Wish]:
        """What has been asked for since the last look, in order."""
        while True:
            try:
                yield self._wishes.get_nowait()
            except Empty:
                return
