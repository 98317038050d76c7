"""The panel of the page in the browser: what a :class:`~aicpg_newton.viewing.desk.Desk` offers, and what it shows."""

from __future__ import annotations

import math
import time as clock
from collections import deque
from typing import Any

import numpy as np

from aicpg_newton.robot.humanoid import CONTROL_RATE
from aicpg_newton.viewing.desk import DIRECTIONS, ChangeGround, Desk, Push, Ramp, Readings, Turn
from aicpg_newton.viewing.stage import LEFT_COLOUR, RIGHT_COLOUR

_ALL = "all robots"

_REFRESH = 0.15
"""Least time between two changes of the readings [s]."""

_STRIP_SECONDS = 3.0
"""How far the gait diagram goes back [s]."""

_STRIP_HEIGHT, _STRIP_SCALE = 66, 2
"""Height of the gait diagram [px], and pixels for each control step."""

_BACKGROUND = (238, 238, 240)
_PHASE_COLOUR = (90, 94, 100)

_REAL_TIME = 0.95
"""A page that shows less than this share of real time says so."""


class Panel:
    """Sliders, buttons and readings in viser's own panel.

    Args:
        gui: The server's ``gui``.
        desk: Where wishes go.
    """

    def __init__(self, gui: Any, desk: Desk) -> None:
        self._desk = desk
        self._robot: int | None = None
        self._strip = GaitDiagram()
        self._refreshed = -math.inf
        self._slider: Any = None
        with gui.add_folder("Controller", order=-2.0):
            if desk.num_robots > 1:
                names = (_ALL, *(self._name(robot) for robot in range(desk.num_robots)))
                self._choice = gui.add_dropdown("Robot", names, initial_value=_ALL)
                self._choice.on_update(lambda _: self._choose(names.index(self._choice.value)))
            if desk.frequencies:
                self._slider = gui.add_slider(
                    "f [Hz]", desk.lowest, desk.highest, step=0.01, initial_value=round(desk.frequencies[0], 2)
                )
                self._slider.on_update(self._turned)
                ramp = gui.add_button("Walk to run and back", hint="f rises to its upper end in about 30 s, and falls")
                ramp.on_click(lambda _: desk.ask(Ramp(self._robot)))
            force = gui.add_slider("Push [N]", 0.0, 500.0, step=10.0, initial_value=200.0)
            direction = gui.add_dropdown("Direction", tuple(DIRECTIONS), initial_value=next(iter(DIRECTIONS)))
            push = gui.add_button("Push", hint="for a tenth of a second, on the torso")
            push.on_click(lambda _: desk.ask(Push(direction.value, float(force.value), self._robot)))
            if desk.grounds:
                ground = gui.add_dropdown("Ground", desk.grounds, initial_value=desk.ground)
                ground.on_update(lambda _: desk.ask(ChangeGround(ground.value)))
        with gui.add_folder("Readings", order=-1.0):
            self._text = gui.add_markdown("")
            self._image = gui.add_image(self._strip.picture(), label="Feet on the ground, phase", format="png")

    def _name(self, robot: int) -> str:
        frequencies = self._desk.frequencies
        return f"robot {robot + 1}" + (f" ({frequencies[robot]:.2f} Hz at first)" if frequencies else "")

    def _choose(self, entry: int) -> None:
        self._robot = entry - 1 if entry else None
        self._strip.clear()

    def _turned(self, event: Any) -> None:
        if event.client_id is not None:  # not what the panel itself has set
            self._desk.ask(Turn(float(event.target.value), self._robot))

    def show(self, readings: Readings, pace: float) -> None:
        """Take the readings of a control step, and show them a few times a second.

        Args:
            readings: The robots'.
            pace: Simulated time that passes in a second of real time [s/s].
        """
        robot = self._robot or 0
        self._strip.add(readings.contact[robot], readings.phase[robot])
        now = clock.monotonic()
        if now - self._refreshed < _REFRESH:
            return
        self._refreshed = now
        self._text.content = table(readings, self._robot, pace)
        self._image.image = self._strip.picture()


def table(readings: Readings, robot: int | None, pace: float) -> str:
    """The readings as a Markdown table, a row for each robot or one alone.

    Args:
        readings: The robots'.
        robot: The only one to show; None for all.
        pace: Simulated time that passes in a second of real time [s/s].
    """
    rows = range(len(readings.speed)) if robot is None else (robot,)
    lines = ["| | f [Hz] | v [m/s] | Fr | phase | falls |", "|---|---|---|---|---|---|"]
    for row in rows:
        degrees = math.degrees(readings.phase[row]) % 360.0
        lines.append(
            f"| {row + 1} | {readings.frequency[row]:.2f} | {readings.speed[row]:.2f} | {readings.froude[row]:.2f}"
            f" | {degrees:.0f}° | {readings.falls[row]} |"
        )
    told = f"t = {readings.time:.1f} s"
    if readings.pushed is not None:
        when, push = readings.pushed
        who = "" if push.robot is None else f"robot {push.robot + 1} "
        told += f"; {who}pushed {push.direction} with {push.force:.0f} N at {when:.1f} s"
    if pace < _REAL_TIME:
        told += f", at {pace:.2f} of real time: this machine does not keep up; show fewer robots"
    return "\n".join([*lines, "", told])


class GaitDiagram:
    """The last seconds of one robot: a bar while a foot is on the ground, right above left, and the phase below."""

    def __init__(self) -> None:
        self._steps: deque[tuple[bool, bool, float]] = deque(maxlen=round(_STRIP_SECONDS * CONTROL_RATE))

    def clear(self) -> None:
        """Begin anew, with another robot."""
        self._steps.clear()

    def add(self, contact: tuple[bool, bool], phase: float) -> None:
        """Take one control step: feet on the ground (right, left) and phase [rad]."""
        self._steps.append((*contact, phase))

    def picture(self) -> np.ndarray:
        """8-bit sRGB, the newest step at the right, shape [height, width, 3]."""
        steps = self._steps.maxlen or 0
        image = np.full((_STRIP_HEIGHT, steps * _STRIP_SCALE, 3), _BACKGROUND, dtype=np.uint8)
        for row, (right, left, phase) in enumerate(self._steps, start=steps - len(self._steps)):
            columns = slice(row * _STRIP_SCALE, (row + 1) * _STRIP_SCALE)
            if right:
                image[4:18, columns] = np.round(255 * np.array(RIGHT_COLOUR))
            if left:
                image[22:36, columns] = np.round(255 * np.array(LEFT_COLOUR))
            share = (phase / (2 * math.pi)) % 1.0
            height = round(share * 20)
            image[62 - height : 64 - height, columns] = _PHASE_COLOUR
        return image
