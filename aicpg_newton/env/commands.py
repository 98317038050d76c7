"""What the robots are told to do."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from aicpg_newton.robot.humanoid import CONTROL_DT


@dataclass(frozen=True)
class Commands:
    """What each robot is told in a control step; every tensor has shape [num_envs]. A change makes a new object.

    :meth:`aicpg_newton.env.environment.Environment.command` is the one place where they are set.
    """

    frequency: torch.Tensor
    """Stride frequency f [Hz]."""
    heading: torch.Tensor
    """Yaw of the target direction in the world [rad]."""
    speed: torch.Tensor | None = None
    """Speed to reach [m/s]; None where none is told."""

    def every(self, step: int, first: int) -> Commands:
        """Those of every so manieth robot, from one of them on."""
        given = {name: each for name, each in vars(self).items() if each is not None}
        return Commands(**{name: each[first::step].clone() for name, each in given.items()})


class FrequencyChanges:
    """Stride frequencies that go to other values at random times, for training.

    Args:
        lowest: Least stride frequency [Hz].
        highest: Greatest stride frequency [Hz].
        interval: Mean time from one change to the next [s]; times are drawn from an exponential distribution.
        rate: Greatest rate of a change [Hz/s]; each is drawn between a fifth of it and all.
        jumps: Share of the changes that happen at once.
        generator: Random numbers, on the device of the robots.
    """

    def __init__(
        self, lowest: float, highest: float, *, interval: float, rate: float, jumps: float, generator: torch.Generator
    ) -> None:
        self._lowest, self._span = lowest, highest - lowest
        self._due, self._rate, self._jumps = CONTROL_DT / interval, rate, jumps
        self._generator = generator

    def begin(self, frequency: torch.Tensor) -> None:
        """All robots keep these stride frequencies [Hz], shape [num_envs], until their first change."""
        self._target, self._step = frequency.clone(), torch.zeros_like(frequency)

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Where the frequencies are going [Hz], and how fast [Hz a step]."""
        return {"target": self._target, "step": self._step}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Go on from :meth:`state_dict`."""
        self._target, self._step = state["target"], state["step"]

    def draw(self, number: int) -> torch.Tensor:
        """Random numbers of a step for so many robots, for :meth:`next`, shape [4, number]."""
        return torch.rand(4, number, generator=self._generator, device=self._generator.device)

    def next(self, frequency: torch.Tensor, begun: torch.Tensor, drawn: torch.Tensor) -> torch.Tensor:
        """Stride frequencies of the next step [Hz]; :meth:`begin` comes first.

        Args:
            frequency: Those of this step [Hz], shape [num_envs].
            begun: Robots whose episode has just begun and that keep their frequency for now, bool, shape [num_envs].
            drawn: From :meth:`draw`, shape [4, num_envs].
        """
        chance, where, how_fast, at_once = drawn.unbind(0)
        due = (chance < self._due) & ~begun
        rate = self._rate * (0.2 + 0.8 * how_fast)
        step = torch.where(at_once < self._jumps, self._span, CONTROL_DT * rate)
        self._target = torch.where(begun, frequency, torch.where(due, self._lowest + self._span * where, self._target))
        self._step = torch.where(due, step, self._step)
        return frequency + (self._target - frequency).clamp(-self._step, self._step)
