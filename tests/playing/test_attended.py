"""Robots that obey a desk: turned, pushed, put on other ground."""

import math

import pytest
import torch

from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.registry import get_task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.playing.attended import ON_RAMP, RAMP_RATE, TURN_RATE, Attended, Knob
from aicpg_newton.playing.rollout import Tally, no_action
from aicpg_newton.robot.humanoid import CONTROL_RATE
from aicpg_newton.viewing.desk import ChangeGround, Desk, Push, Ramp, Restart, Turn

GRAVITY_LEGS = 9.81 * 0.855


@pytest.fixture
def attended(puppet, pattern: PatternNetwork):
    """Two robots at 0.9 and 1.3 Hz with a desk, a plane and a terrain; engines are kept in ``engines``."""
    frequency = torch.tensor([0.9, 1.3])
    desk = Desk(frequencies=frequency.tolist(), lowest=0.7, highest=1.5, grounds=("flat", "rough"), ground="flat")
    engines = []

    def begin(ground: str):
        task = get_task("flat")
        terrain = Terrain.make(Ground(height_range=0.1, length=24.0, width=16.0)) if ground == "rough" else None
        engines.append(puppet(2, terrain))
        environment = Environment(task, engines[-1], pattern)
        environment.restart(frequency)
        return environment, no_action

    made = Attended(desk, Tally(frequency), begin)
    return made, desk, engines


def test_a_knob_takes_its_time():
    """A quarter of a hertz a second either way, then it stays."""
    knob = Knob(0.9)
    assert knob.step() == 0.9
    knob.turn((1.0, 0.25))
    way = [knob.step() for _ in range(30)]
    assert way[0] == pytest.approx(0.9 + 0.25 / 60)
    assert way[23] == pytest.approx(1.0) and way[-1] == 1.0
    knob.turn((0.9, 0.25))
    assert knob.step() == pytest.approx(1.0 - 0.25 / 60)


def test_a_turn_is_for_one_robot_or_for_all(attended):
    """The others keep theirs; a command is obeyed when the step after it is over."""
    robots, desk, _ = attended
    seen = []
    for step, frame in enumerate(robots.frames(120)):
        seen.append(frame.frequency.tolist())
        if step == 9:
            assert not robots.turned
            desk.ask(Turn(1.25, robot=0))
        if step == 39:
            desk.ask(Turn(1.25))
    assert robots.turned
    assert seen[:11] == [pytest.approx([0.9, 1.3])] * 11
    assert seen[11] == pytest.approx([0.9 + TURN_RATE / CONTROL_RATE, 1.3])
    assert seen[39][1] == pytest.approx(1.3)
    assert seen[-1] == pytest.approx([1.25, 1.25])


def test_a_ramp_goes_up_and_comes_back(attended):
    """Down to 0.7 Hz as the slider goes, up to 1.4 Hz in 30 s, back in 30 s."""
    knob = Knob(0.9)
    knob.turn(*ON_RAMP)
    seen = [knob.step() for _ in range(64 * 60)]
    bottom = round(0.2 / TURN_RATE * CONTROL_RATE)
    assert min(seen) == 0.7 and max(seen) == 1.4
    assert seen[bottom + 15 * 60] == pytest.approx(0.7 + 15 * RAMP_RATE, abs=0.002)
    assert seen[bottom + 45 * 60] == pytest.approx(1.4 - 15 * RAMP_RATE, abs=0.002)
    assert seen[-1] == 0.7
    robots, desk, _ = attended
    desk.ask(Ramp(robot=0))
    *_, last = robots.frames(12)
    assert last.frequency.tolist() == pytest.approx([0.9 - 10 * TURN_RATE / CONTROL_RATE, 1.3])


def test_a_push_acts_on_one_robot_for_a_tenth_of_a_second(attended):
    """Six control steps, along the world's axes; robots go along x, so left is +y."""
    robots, desk, engines = attended
    push, told = Push("to the left", 150.0, robot=1), []
    for step, frame in enumerate(robots.frames(20)):
        assert frame.readings is not None
        told.append(frame.readings.pushed)
        if step == 4:
            desk.ask(push)
    assert told == [None] * 5 + [(pytest.approx(5 / CONTROL_RATE), push)] * 15
    pushes = [call["push"] for call in engines[0].calls]
    assert [push is not None for push in pushes] == [False] * 5 + [True] * 6 + [False] * 9
    assert pushes[5].tolist() == [[0.0, 0.0, 0.0], [0.0, 150.0, 0.0]]


def test_restart_and_other_ground_keep_the_frequency(attended):
    """Robots begin anew where f stands; the terrain is the new engine's."""
    robots, desk, engines = attended
    desk.ask(Turn(1.1))
    terrains, frequencies = [], []
    for step, frame in enumerate(robots.frames(300)):
        terrains.append(robots.terrain)
        frequencies.append(frame.frequency.tolist())
        if step == 99:
            desk.ask(Restart())
        if step == 199:
            desk.ask(ChangeGround("rough"))
    assert terrains[199] is None and terrains[200] is engines[1].terrain is not None
    assert len(frequencies) == 300
    assert frequencies[99] == frequencies[102] == frequencies[202] == pytest.approx([1.1, 1.1])
    assert engines[0].last_reset["mask"].all()


def test_readings(attended):
    """Speed is the mean over a second, the Froude number goes with it, feet carry or do not."""
    robots, _, engines = attended
    for step, frame in enumerate(robots.frames(90)):
        speed = 1.0 if step < 60 else 3.0
        engines[0].overrides["root_linear_velocity"] = torch.tensor([[speed, 0.0, 0.0], [0.0, 0.0, 0.0]])
        force = torch.zeros(2, 2, 3)
        force[0, 1, 2] = 400.0
        engines[0].overrides["foot_force"] = force
        read = frame.readings
    assert read is not None
    assert read.time == pytest.approx(1.5)
    assert read.speed == pytest.approx([(31 * 1.0 + 29 * 3.0) / 60, 0.0], abs=1e-5)
    assert read.froude[0] == pytest.approx(read.speed[0] ** 2 / GRAVITY_LEGS, rel=1e-4)
    assert read.contact == [(False, True), (False, False)]
    assert read.frequency == pytest.approx([0.9, 1.3]) and len(read.falls) == 2
    assert all(0.0 <= phase <= 2 * math.pi for phase in read.phase)
