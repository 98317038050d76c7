"""A policy on trial: some robots walk and some run, always from the same start states, while it is being trained."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import torch
from tensordict import TensorDict

from aicpg_newton.device import torch_threads
from aicpg_newton.engines import StepMeasures
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.outcome import StepOutcome
from aicpg_newton.env.task import Task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.robot.humanoid import CONTROL_RATE

FREQUENCIES = (0.9, 1.3)
"""A walk and a run [Hz], near the imitated clips'."""

_SEED = 12345


class Trial:
    """Robots in groups, one for each of :data:`FREQUENCIES`, undisturbed.

    Args:
        task: What is learned.
        engine: Name of the engine.
        pattern: The pattern network S.
        device: Device of the physics.
        robots: Robots in each group.
        duration: Simulated time [s].
    """

    def __init__(
        self, task: Task, engine: str, pattern: PatternNetwork, device: torch.device, *, robots: int, duration: float
    ) -> None:
        self.robots = robots
        self.steps = round(duration * CONTROL_RATE)
        endless = replace(task.termination, episode_steps=self.steps + 1)
        self._task = replace(task.undisturbed(), termination=endless)
        self._engine = engine_for(self._task, engine, robots * len(FREQUENCIES), device)
        self._pattern = pattern
        self.terrain = self._engine.terrain
        """The ground; None for a plane."""

    def environment(self) -> Environment:
        """The robots at the start, group by group."""
        environment = Environment(self._task, self._engine, self._pattern, seed=_SEED)
        frequency = torch.tensor(FREQUENCIES, device=environment.device)
        environment.restart(frequency.repeat_interleave(self.robots))
        return environment

    def measures(self) -> StepMeasures:
        """Measures of the step that came last."""
        return self._engine.measures()

    @torch.no_grad()
    def outcomes(self, decide: Callable[[TensorDict], torch.Tensor]) -> Iterator[StepOutcome]:
        """What comes of each control step.

        Args:
            decide: The policy: from observations to actions, shape [num_envs, 28].
        """
        environment = self.environment()
        observed = environment.get_observations()
        with torch_threads(1):
            for _ in range(self.steps):
                observed = environment.step(decide(observed))[0]
                yield environment.outcome
