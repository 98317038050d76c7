"""Throughput: python -m aicpg_newton.benchmark. Rates of each engine, of the environment around it and of learning."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
import tyro

from aicpg_newton.cpg import PatternNetwork
from aicpg_newton.device import resolve_device, torch_threads
from aicpg_newton.engines import ENGINES, Engine
from aicpg_newton.environment import Environment, engine_for
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.learning.runner import Runner
from aicpg_newton.task import Task
from tasks import get_task

_BURST = 20
"""Control steps timed in one go."""


@dataclass(kw_only=True)
class BenchmarkOptions:
    """Measure control steps per second, in all environments together."""

    tasks: tuple[str, ...] = ("flat", "uneven")
    """flat, uneven or both, to see side by side what their ground costs."""
    num_envs: tuple[int, ...] = (256,)
    """Numbers of environments to measure."""
    engines: tuple[str, ...] = ()
    """Engines to measure; those that run on the device when none is given."""
    device: str = "auto"
    """auto, cpu or cuda:N."""
    seconds: float = 5.0
    """Time to measure each rate for [s]."""
    iterations: int = 2
    """Learning iterations to time; 0 leaves learning out."""


@dataclass
class Rates:
    """What one engine does with one number of environments; rates in control steps per second."""

    engine: str
    task: str
    num_envs: int
    build: float
    """Time from nothing to the end of the first control step [s]."""
    bare: float | None
    """The physics library's own loop over the same model, batch and substeps, where there is one."""
    engine_alone: float
    environment: float
    learning: float | None
    """Samples per second of whole learning iterations."""
    buffers: str
    """Fullest contact and constraint buffers."""

    @property
    def outside_physics(self) -> float:
        """Share of the environment's time that is not the engine's."""
        return 1.0 - self.environment / self.engine_alone


def measure(options: BenchmarkOptions, name: str, task: Task, num_envs: int, device: torch.device) -> Rates:
    """Measure one engine with one number of environments, walking with the CPG and a small random reflex."""
    began = time.perf_counter()
    engine = engine_for(task, name, num_envs, device)
    environment = Environment(task, engine, PatternNetwork.load())
    actions = 0.4 * torch.randn(num_envs, environment.num_actions, device=device)
    environment.step(actions)
    _finish(device)
    build = time.perf_counter() - began

    def restart() -> None:
        environment.restart(environment.frequency)

    def rate(make_step: Callable[[], Callable[[], object]]) -> float:
        return num_envs * _calls_per_second(restart, make_step, options.seconds, device)

    with torch_threads(1):  # as in training
        around = rate(lambda: lambda: environment.step(actions))
        command = environment.control.command(0.0 * actions, engine.state)
        alone = rate(lambda: lambda: engine.step(*command))
        bare_loop = getattr(engine, "bare_loop", None)
        bare = None if bare_loop is None else rate(bare_loop)
        restart()
    learning = _learning_rate(environment, options.iterations)
    return Rates(name, task.name, num_envs, build, bare, alone, around, learning, _buffers(engine))


def _learning_rate(environment: Environment, iterations: int) -> float | None:
    """Samples per second of whole iterations, after a first one that is not counted."""
    if iterations < 1:
        return None
    runner = Runner(environment, {"seed": 0})
    runner.learn(1)
    _finish(environment.device)
    began = time.perf_counter()
    runner.learn(iterations)
    _finish(environment.device)
    samples = iterations * environment.num_envs * environment.task.learning.steps_per_iteration
    return samples / (time.perf_counter() - began)


def _calls_per_second(
    restart: Callable[[], None],
    make_step: Callable[[], Callable[[], object]],
    seconds: float,
    device: torch.device,
) -> float:
    """Rate of a call, timed in bursts that begin with walking robots: fallen ones have more contacts and cost more."""
    spent, calls = 0.0, 0
    while spent < seconds:
        restart()
        step = make_step()
        step()
        _finish(device)
        began = time.perf_counter()
        for _ in range(_BURST):
            step()
        _finish(device)
        spent += time.perf_counter() - began
        calls += _BURST
    return calls / spent


def _finish(device: torch.device | str) -> None:
    """Wait until the device has done its work."""
    if torch.device(device).type == "cuda":
        torch.cuda.synchronize(device)


def _buffers(engine: Engine) -> str:
    high_water = getattr(engine, "high_water", None)
    if high_water is None:
        return "-"
    most = high_water()
    return f"{most['contacts']:.1f} contacts, {most['constraints']} constraints, {engine.overflows()} overflows"


def table(rows: list[Rates]) -> str:
    """The rates as a Markdown table."""
    head = (
        "engine",
        "task",
        "environments",
        "first step [s]",
        "bare loop",
        "engine",
        "environment",
        "outside",
        "learning",
    )
    cells = [(*head, "buffers"), ("---",) * (len(head) + 1)]
    for row in rows:
        bare = "-" if row.bare is None else f"{row.bare:,.0f} ({row.engine_alone / row.bare:.0%})"
        learning = "-" if row.learning is None else f"{row.learning:,.0f}"
        rates = (bare, f"{row.engine_alone:,.0f}", f"{row.environment:,.0f}", f"{row.outside_physics:.0%}", learning)
        cells.append((row.engine, row.task, str(row.num_envs), f"{row.build:.1f}", *rates, row.buffers))
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def benchmark(options: BenchmarkOptions) -> list[Rates]:
    """Measure all engines, tasks and numbers of environments asked for, and print the table.

    Raises:
        UserError: An option cannot be met.
    """
    if not options.tasks:
        raise UserError("--tasks is empty; give at least one")
    if not options.num_envs or min(options.num_envs) < 1:
        raise UserError(f"--num-envs is {options.num_envs}; give positive numbers")
    if not 0.0 < options.seconds < float("inf"):
        raise UserError(f"--seconds is {options.seconds}; give a positive number")
    device = resolve_device(options.device)
    names = options.engines or (("newton",) if device.type == "cuda" else tuple(ENGINES))
    where = torch.cuda.get_device_name(device) if device.type == "cuda" else f"CPU, {torch.get_num_threads()} threads"
    tasks = [get_task(name) for name in options.tasks]
    rows = [
        measure(options, name, task, num_envs, device)
        for name in names
        for num_envs in options.num_envs
        for task in tasks
    ]
    print(f"Control steps per second, {where}; in brackets: engine as a share of the bare loop.")
    print(table(rows))
    return rows


if __name__ == "__main__":
    run_command(lambda: benchmark(tyro.cli(BenchmarkOptions, description=__doc__)))
