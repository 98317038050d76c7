"""The page's readings and pictures, without a browser."""

import math
from dataclasses import replace

import numpy as np
import pytest

from aicpg_newton.viewing.desk import Desk, Push, Readings, Restart, Turn
from aicpg_newton.viewing.page import GaitDiagram, table
from aicpg_newton.viewing.stage import LEFT_COLOUR, RIGHT_COLOUR

READINGS = Readings(
    time=12.3,
    frequency=[0.9, 1.3],
    phase=[0.5 * math.pi, 3 * math.pi],
    speed=[1.47, 3.25],
    froude=[0.26, 1.26],
    contact=[(True, False), (False, False)],
    falls=[0, 2],
)


def test_wishes_come_in_order_and_once():
    """A desk hands on what was asked for since the last look."""
    desk = Desk(frequencies=[0.9])
    assert list(desk.asked()) == []
    for wish in (Turn(1.2), Push("forwards", 100.0), Restart()):
        desk.ask(wish)
    assert list(desk.asked()) == [Turn(1.2), Push("forwards", 100.0), Restart()]
    assert list(desk.asked()) == []


def test_table_of_readings():
    """A row for each robot or one alone; the phase in degrees of one turn; a slow machine is told of."""
    lines = table(READINGS, None, pace=1.0).splitlines()
    assert lines[2] == "| 1 | 0.90 | 1.47 | 0.26 | 90° | 0 |"
    assert lines[3] == "| 2 | 1.30 | 3.25 | 1.26 | 180° | 2 |"
    assert lines[-1] == "t = 12.3 s"
    alone = table(READINGS, 1, pace=0.5).splitlines()
    assert alone[2] == lines[3] and len(alone) == len(lines) - 1
    assert "0.50 of real time" in alone[-1] and "does not keep up" in alone[-1]


def test_the_last_push_is_told():
    """Of whom, whither, how hard and when."""
    all_robots = replace(READINGS, pushed=(11.03, Push("to the left", 200.0)))
    assert table(all_robots, None, pace=1.0).splitlines()[-1] == "t = 12.3 s; pushed to the left with 200 N at 11.0 s"
    one = replace(READINGS, pushed=(11.03, Push("forwards", 50.0, robot=1)))
    assert "; robot 2 pushed forwards with 50 N at 11.0 s, at 0.50 of real time" in table(one, None, pace=0.5)


def test_gait_diagram():
    """The newest step is at the right; the right foot's bar is above the left's; the phase rises."""
    diagram = GaitDiagram()
    empty = diagram.picture()
    diagram.add((True, False), 0.0)
    diagram.add((False, True), math.pi)
    before, last = diagram.picture()[:, -4:-2], diagram.picture()[:, -2:]
    assert before[10, 0].tolist() == pytest.approx([255 * c for c in RIGHT_COLOUR], abs=1)
    assert last[30, 0].tolist() == pytest.approx([255 * c for c in LEFT_COLOUR], abs=1)
    assert (before[22:36] == empty[22:36, :2]).all() and (last[4:18] == empty[4:18, :2]).all()
    heights = [np.flatnonzero((column[40:, 0] != empty[40:, 0]).any(axis=1))[0] for column in (before, last)]
    assert heights[0] - heights[1] == 10
    assert (diagram.picture()[:, :-4] == empty[:, :-4]).all()
    diagram.clear()
    assert (diagram.picture() == empty).all()
