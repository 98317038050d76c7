"""Robots that somebody at a desk turns, pushes and puts on other ground while they move."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import torch

from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.learning.policy import Agent
from aicpg_newton.playing.rollout import Frame, Tally, physical_frames
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE
from aicpg_newton.robot.locomotion import feet_on_ground, froude_number
from aicpg_newton.viewing.desk import DIRECTIONS, ChangeGround, Desk, Push, Ramp, Readings, Restart, Wish

if TYPE_CHECKING:
    from aicpg_newton.env.environment import Environment

TURN_RATE = 0.25
"""How fast the stride frequency follows the slider [Hz/s]; at 0.5 robots fell when it was turned from 1.35 to 0.85."""

RAMP_RATE = 0.7 / 30.0
"""How fast it rises and falls on a ramp [Hz/s]: from 0.7 to 1.4 Hz in 30 s, as in the paper's Fig. 4."""

ON_RAMP = ((0.7, TURN_RATE), (1.4, RAMP_RATE), (0.7, RAMP_RATE))
"""The way of a ramp: to where it begins, up, and down again."""


class Knob:
    """The stride frequency of one robot on its way to where it has been turned.

    Args:
        frequency: Where it stands [Hz].
    """

    def __init__(self, frequency: float) -> None:
        self.frequency = frequency
        self._way: deque[tuple[float, float]] = deque()

    def turn(self, *way: tuple[float, float]) -> None:
        """Forget where it was going, and go to these frequencies [Hz], one after the other, at these rates [Hz/s]."""
        self._way = deque(way)

    def step(self) -> float:
        """Go on for one control step; returns the new frequency [Hz]."""
        if self._way:
            target, rate = self._way[0]
            most = rate * CONTROL_DT
            self.frequency += min(max(target - self.frequency, -most), most)
            if self.frequency == target:
                self._way.popleft()
        return self.frequency


class Attended:
    """A roll-out that obeys a desk.

    Args:
        desk: Where wishes come from.
        tally: Counts to add to.
        begin: Makes the environment and what controls it on a ground, given its name among the desk's. The environment
            has been started at the tally's frequencies.
    """

    def __init__(self, desk: Desk, tally: Tally, begin: Callable[[str], tuple[Environment, Agent]]) -> None:
        self._desk, self._tally, self._begin = desk, tally, begin
        self._environment, self._agent = begin(desk.ground)
        self._knobs = [Knob(frequency) for frequency in desk.frequencies]
        self._speeds: deque[torch.Tensor] = deque(maxlen=round(CONTROL_RATE))
        self._pushed: tuple[float, Push] | None = None
        self.turned = False
        """Whether anybody has turned a stride frequency."""

    @property
    def terrain(self) -> Terrain | None:
        """The ground that the robots are on; None for a plane."""
        return self._environment.engine.terrain

    def frames(self, steps: int) -> Iterator[Frame]:
        """The frames of so many control steps, with readings."""
        rest = self._rollout(steps)
        for step in range(1, steps + 1):
            frame = next(rest)
            frame.readings = self._read(frame, step)
            yield frame
            for wish in self._desk.asked():
                self._obey(wish, step * CONTROL_DT)
                if isinstance(wish, ChangeGround):
                    rest = self._rollout(steps - step)
            if self.turned:
                now = [knob.step() for knob in self._knobs]
                self._environment.command(frequency=torch.tensor(now, device=self._environment.device))

    def _rollout(self, steps: int) -> Iterator[Frame]:
        return physical_frames(self._environment, self._agent, steps, self._tally)

    def _obey(self, wish: Wish, time: float) -> None:
        if isinstance(wish, Restart | ChangeGround):
            frequency = self._environment.commands.frequency
            if isinstance(wish, ChangeGround):
                self._environment, self._agent = self._begin(wish.ground)
            self._environment.restart(frequency)
            self._speeds.clear()
        elif isinstance(wish, Push):
            force = torch.zeros(self._environment.num_envs, 3)
            force[self._robots(wish.robot)] = wish.force * torch.tensor(DIRECTIONS[wish.direction])
            self._environment.push(force.to(self._environment.device))
            self._pushed = time, wish
        else:
            way = ON_RAMP if isinstance(wish, Ramp) else [(wish.frequency, TURN_RATE)]
            for knob in self._knobs[self._robots(wish.robot)]:
                knob.turn(*way)
            self.turned = True

    @staticmethod
    def _robots(robot: int | None) -> slice:
        return slice(None) if robot is None else slice(robot, robot + 1)

    def _read(self, frame: Frame, step: int) -> Readings:
        state = self._environment.outcome.state
        self._speeds.append(state.root_linear_velocity[:, 0])
        speed = torch.stack(list(self._speeds)).mean(dim=0)
        contact = feet_on_ground(state.foot_force).tolist()
        return Readings(
            time=step * CONTROL_DT,
            frequency=frame.frequency.tolist(),
            phase=frame.phase.tolist(),
            speed=speed.tolist(),
            froude=froude_number(speed).tolist(),
            contact=[(right, left) for right, left in contact],
            falls=self._tally.falls.tolist(),
            pushed=self._pushed,
        )
