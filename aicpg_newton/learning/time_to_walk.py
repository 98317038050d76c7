"""How long a training takes until it walks and runs: samples, seconds, and where the seconds go."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from tensordict import TensorDict

from aicpg_newton.device import finish
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.task import Task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning.runner import Runner
from aicpg_newton.learning.trial import FREQUENCIES, Trial
from aicpg_newton.robot.humanoid import CONTROL_RATE

DURATION = 20.0
"""Simulated time to stay up for [s]."""

ROBOTS = 64
"""Robots at each frequency."""

SHARE = 0.95
"""Share of them that has to stay up, at each frequency."""

INTERVAL = 81_920
"""Samples from test to test."""

_LOOK = 10
"""Control steps after which a test sees whether it is lost already."""


@dataclass
class Test:
    """How a policy did at some point of a training."""

    samples: int
    """Control steps of the training so far, over all environments."""
    seconds: float
    """Time of the training so far, without tests [s]."""
    learning_rate: float
    """Learning rate of the next update."""
    standing: tuple[float, ...]
    """Share of the robots that stayed up, at each of :data:`FREQUENCIES`."""
    lasted: float
    """Simulated time [s] until more had fallen than may, or :data:`DURATION`."""

    @property
    def passed(self) -> bool:
        """Whether it walks and runs."""
        return min(self.standing) >= SHARE

    def line(self) -> str:
        """The test in words."""
        shares = ", ".join(
            f"{share:.0%} at {frequency} Hz" for frequency, share in zip(FREQUENCIES, self.standing, strict=True)
        )
        return f"{self.samples:10,d} samples {self.seconds:7.1f} s   after {self.lasted:4.1f} s stand {shares}"


@dataclass
class WalkingTime:
    """What a training took until it passed the test."""

    seed: int
    passed: bool = False
    """Whether it did; if not, the numbers are what was spent in vain."""
    seconds: float = 0.0
    """Time of the training without tests [s]."""
    samples: int = 0
    """Control steps over all environments."""
    physics_seconds: float = 0.0
    """Part of the time in the engine [s]."""
    environment_seconds: float = 0.0
    """Part in the environment around it [s]."""
    learning_seconds: float = 0.0
    """Part in the networks, acting and learning [s]."""
    cpu_seconds: float = 0.0
    """CPU time of the training, of all threads together [s]."""
    tests: list[Test] = field(default_factory=list)
    """All tests, in order."""


class Stopwatch:
    """Adds up the time spent in some methods.

    Args:
        device: Device that does the work, and is waited for.
    """

    def __init__(self, device: torch.device) -> None:
        self.seconds = 0.0
        self._device = device

    def watch(self, owner: Any, *names: str) -> None:
        """From now on time these methods of an object."""
        for name in names:
            setattr(owner, name, self._timed(getattr(owner, name)))

    def _timed(self, method: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            result = method(*args, **kwargs)
            finish(self._device)
            self.seconds += time.perf_counter() - began
            return result

        return timed


def stays_up(trial: Trial, decide: Callable[[TensorDict], torch.Tensor]) -> tuple[tuple[float, ...], float]:
    """Whether a policy walks and runs.

    Args:
        trial: The robots.
        decide: The policy: from observations to actions, shape [num_envs, 28].

    Returns:
        Share that stands at each frequency at the end, and simulated time [s] to there. It is over as soon as more
        robots have fallen at one of the frequencies than may.
    """
    standing, step = torch.ones(len(FREQUENCIES), trial.robots, dtype=torch.bool), 0
    for step, outcome in enumerate(trial.outcomes(decide), start=1):
        ended = outcome.fallen | outcome.off_course
        standing = standing.to(ended.device) & ~ended.view_as(standing)
        if step % _LOOK == 0 and standing.float().mean(dim=1).min() < SHARE:
            break
    return tuple(standing.float().mean(dim=1).tolist()), step / CONTROL_RATE


def time_to_walk(
    task: Task,
    *,
    seed: int,
    engine: str,
    num_envs: int,
    device: torch.device,
    learner_device: torch.device | None = None,
    maximum_samples: int,
    show: Callable[[str], None] = print,
) -> WalkingTime:
    """Train from scratch until :data:`SHARE` of the robots stay up for :data:`DURATION` at all :data:`FREQUENCIES`.

    Args:
        task: What is to be learned.
        seed: Seed of networks, exploration and resets.
        engine: ``newton``, ``mujoco`` or ``auto``.
        num_envs: Number of environments to learn on.
        device: Device of the physics.
        learner_device: Device of the networks; None for that of the physics.
        maximum_samples: Samples after which it is given up.
        show: Is given a line for each test.

    Raises:
        UserError: A setting cannot be run.
    """
    pattern = PatternNetwork.load()
    torch.manual_seed(seed)
    with contextlib.redirect_stdout(io.StringIO()):  # rsl_rl prints the layers of every network it makes
        trial = Trial(task, engine, pattern, device, robots=ROBOTS, duration=DURATION)
        environment = Environment(task, engine_for(task, engine, num_envs, device), pattern, seed=seed)
        runner = Runner(environment, {"seed": seed}, device=learner_device)
    physics, around = Stopwatch(device), Stopwatch(device)
    physics.watch(environment.engine, "step", "reset")
    around.watch(environment, "step")
    an_iteration = num_envs * task.learning.steps_per_iteration
    iterations = max(1, round(INTERVAL / an_iteration))
    result = WalkingTime(seed)
    while result.samples < maximum_samples and not result.passed:
        began, began_cpu = time.perf_counter(), time.process_time()
        runner.learn(iterations, init_at_random_ep_len=result.samples == 0)
        finish(device)
        result.seconds += time.perf_counter() - began
        result.cpu_seconds += time.process_time() - began_cpu
        result.samples += iterations * an_iteration
        tested = Test(result.samples, result.seconds, runner.alg.learning_rate, *stays_up(trial, runner.decide))
        result.tests.append(tested)
        result.passed = tested.passed
        show(f"seed {seed}: {tested.line()}")
    result.physics_seconds = physics.seconds
    result.environment_seconds = around.seconds - physics.seconds
    result.learning_seconds = result.seconds - around.seconds
    return result
