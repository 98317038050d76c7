"""How fast: python -m aicpg_newton.benchmark. Rates of each engine, of the environment around it and of learning.

With ``--time-to-walk``: how long a training takes until it walks and runs.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeVar

import torch
import tyro

from aicpg_newton.device import (
    Compile,
    finish,
    resolve_device,
    resolve_learner_device,
    torch_threads,
    waits_for_cores,
    worth_compiling,
)
from aicpg_newton.engines import ENGINES, Engine, engine_name
from aicpg_newton.env.methods import on_task
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.files import write_text
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.ranges import AT_LEAST_ONE, ENVIRONMENTS, NOT_NEGATIVE, POSITIVE, SEED, check_ranges
from aicpg_newton.viewing.output import writable_path

if TYPE_CHECKING:
    from aicpg_newton.env.environment import Environment
    from aicpg_newton.learning.time_to_walk import WalkingTime

_BURST = 20
"""Control steps timed in one go."""

_DISTURBED = 0.1
"""Share of the time without a core from which on a rate is doubted."""

_Settings = TypeVar("_Settings", bound=Task)


@dataclass(kw_only=True)
class BenchmarkOptions(Generic[_Settings]):
    """Measure control steps per second, in all environments together."""

    tasks: tuple[str, ...] = ("flat", "uneven")
    """flat, uneven or both, to see side by side what their ground costs."""
    num_envs: Annotated[tuple[int, ...], ENVIRONMENTS] = (256,)
    """Numbers of environments to measure."""
    engines: tuple[str, ...] = ()
    """Engines to measure; those that run on the device when none is given."""
    device: str = "auto"
    """auto, cpu or cuda:N."""
    seconds: Annotated[float, POSITIVE] = 5.0
    """Time to measure each rate for [s]."""
    iterations: Annotated[int, NOT_NEGATIVE] = 8
    """Learning iterations to time; 0 leaves learning out."""
    compile: Compile = "auto"
    """As for train.py."""
    learner_device: str | None = None
    """Device of the networks beside physics on the CPU (engine mujoco): cuda:N or mps."""
    time_to_walk: bool = False
    """Measure instead how long a training of the first task on the first engine takes until it walks and runs: from
    scratch until 95 % of 64 robots each stay up for 20 s at 0.9 and at 1.3 Hz."""
    seeds: Annotated[tuple[int, ...], SEED] = (0,)
    """Seeds of the trainings, one after the other."""
    max_samples: Annotated[int, AT_LEAST_ONE] = 8_000_000
    """Samples after which such a training is given up."""
    json: Path | None = None
    """Write what was measured to this file as well: a list with an object for each training, or for each row."""
    settings: Annotated[_Settings, tyro.conf.arg(name="")]


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
    waiting: float
    """Share of the time in which a thread was ready to go on, but other work had the cores; rates are too low by it."""
    buffers: str
    """Fullest contact and constraint buffers."""

    @property
    def outside_physics(self) -> float:
        """Share of the environment's time that is not the engine's."""
        return 1.0 - self.environment / self.engine_alone


def measure(
    options: BenchmarkOptions, name: str, task: Task, num_envs: int, device: torch.device, learner_device: torch.device
) -> Rates:
    """Measure one engine with one number of environments, walking with the CPG and a small random reflex."""
    from aicpg_newton.env.environment import Environment, engine_for  # here: seconds to load, and options may be wrong

    began = time.perf_counter()
    engine = engine_for(task, name, num_envs, device)
    compiled = worth_compiling(options.compile, device)
    environment = Environment(task, engine, PatternNetwork.load(), compiled=compiled)
    actions = 0.4 * torch.randn(num_envs, environment.num_actions, device=device)
    environment.step(actions)
    finish(device)
    build = time.perf_counter() - began

    began, waited = time.perf_counter(), waits_for_cores()

    def restart() -> None:
        environment.restart(environment.commands.frequency)

    def rate(make_step: Callable[[], Callable[[], object]]) -> float:
        return num_envs * _calls_per_second(restart, make_step, options.seconds, device)

    with torch_threads(1):  # as in training
        around = rate(lambda: lambda: environment.step(actions))
        command = environment.actuation.command(0.0 * actions, engine.state)
        alone = rate(lambda: lambda: engine.step(*command))
        bare_loop = getattr(engine, "bare_loop", None)
        bare = None if bare_loop is None else rate(bare_loop)
        restart()
    learning = _learning_rate(environment, options.iterations, learner_device)
    longest = max((end - waited.get(thread, 0.0) for thread, end in waits_for_cores().items()), default=0.0)
    waiting = longest / (time.perf_counter() - began)
    return Rates(name, task.name, num_envs, build, bare, alone, around, learning, waiting, _buffers(engine))


def _learning_rate(environment: Environment, iterations: int, device: torch.device) -> float | None:
    """Samples per second of whole iterations, after a first one that is not counted."""
    if iterations < 1:
        return None
    from aicpg_newton.learning.runner import Runner

    runner = Runner(environment, {"seed": 0}, device=device)
    runner.learn(1)
    finish(environment.device)
    began = time.perf_counter()
    runner.learn(iterations)
    finish(environment.device)
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
        finish(device)
        began = time.perf_counter()
        for _ in range(_BURST):
            step()
        finish(device)
        spent += time.perf_counter() - began
        calls += _BURST
    return calls / spent


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
        "waiting",
    )
    cells = [(*head, "buffers"), ("---",) * (len(head) + 1)]
    for row in rows:
        bare = "-" if row.bare is None else f"{row.bare:,.0f} ({row.engine_alone / row.bare:.0%})"
        learning = "-" if row.learning is None else f"{row.learning:,.0f}"
        rates = (bare, f"{row.engine_alone:,.0f}", f"{row.environment:,.0f}", f"{row.outside_physics:.0%}", learning)
        waiting = f"{row.waiting:.0%}"
        cells.append((row.engine, row.task, str(row.num_envs), f"{row.build:.1f}", *rates, waiting, row.buffers))
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def doubts(rows: list[Rates]) -> str:
    """What speaks against the rates, in a sentence; nothing where the cores were free."""
    most = max((row.waiting for row in rows), default=0.0)
    if most < _DISTURBED:
        return ""
    return (
        f"Other work had the cores for up to {most:.0%} of the time (column waiting), so these rates are too low, and"
        " not all by as much; measure again when the machine is free."
    )


def walking_table(results: list[WalkingTime]) -> str:
    """Time to walk of each training and the median, as a Markdown table."""
    head = ("seed", "samples", "seconds", "physics", "environment", "learning", "samples a second", "walks")
    cells = [head, ("---",) * len(head)]
    for each in results:
        parts = (each.physics_seconds, each.environment_seconds, each.learning_seconds)
        shares = (f"{part:.0f} s ({part / each.seconds:.0%})" for part in parts)
        rate = f"{each.samples / each.seconds:,.0f}"
        passed = "yes" if each.passed else "no"
        cells.append((str(each.seed), f"{each.samples:,d}", f"{each.seconds:.0f}", *shares, rate, passed))
    middle = [statistics.median(getattr(each, name) for each in results) for name in ("samples", "seconds")]
    cells.append(("median", f"{middle[0]:,.0f}", f"{middle[1]:.0f}", *("",) * 5))
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def benchmark(options: BenchmarkOptions) -> list[Rates]:
    """Measure all engines, tasks and numbers of environments asked for, and print the table.

    Raises:
        UserError: An option cannot be met.
    """
    device, where = _check(options)
    names = options.engines or (("newton",) if device.type == "cuda" else tuple(ENGINES))
    learner_devices = {
        name: resolve_learner_device(options.learner_device, engine_name(name, device), device) for name in names
    }
    others = [on_task(options.settings, get_task(name)) for name in options.tasks[1:]]
    rows = [
        measure(options, name, task, num_envs, device, learner_devices[name])
        for name in names
        for num_envs in options.num_envs
        for task in (options.settings, *others)
    ]
    print(f"Control steps per second, {where}; in brackets: engine as a share of the bare loop.")
    print(table(rows))
    if doubts(rows):
        print(doubts(rows))
    _write(options.json, rows)
    return rows


def time_to_walk(options: BenchmarkOptions) -> list[WalkingTime]:
    """Train with each seed until it walks and runs, and print the table.

    Raises:
        UserError: An option cannot be met.
    """
    device, where = _check(options)
    from aicpg_newton.learning import time_to_walk as walking  # here: seconds to load, and options may be wrong

    name = engine_name(options.engines[0] if options.engines else "auto", device)
    learner_device = resolve_learner_device(options.learner_device, name, device)
    task, num_envs = options.settings, options.num_envs[0]
    print(f"Time to walk, task {task.name}, engine {name}, {num_envs} environments, {where}.")
    results: list[WalkingTime] = []
    for seed in options.seeds:
        result = walking.time_to_walk(
            task,
            seed=seed,
            engine=name,
            num_envs=num_envs,
            device=device,
            learner_device=learner_device,
            maximum_samples=options.max_samples,
        )
        results.append(result)
        _write(options.json, results)
    print(walking_table(results))
    return results


def _check(options: BenchmarkOptions) -> tuple[torch.device, str]:
    """Device of the physics, and its description, once all options make sense."""
    if not options.tasks:
        raise UserError("--tasks is empty; give at least one")
    for name in options.tasks:
        get_task(name)
    check_ranges(options, "--")
    for name in ("num_envs", "seeds"):
        if not getattr(options, name):
            raise UserError(f"--{name.replace('_', '-')} is empty; give at least one")
    if options.json is not None:
        writable_path(options.json, ".json")
    options.settings.validate()
    device = resolve_device(options.device)
    if device.type == "cuda":
        return device, torch.cuda.get_device_name(device)
    return device, f"CPU, {torch.get_num_threads()} threads"


def _write(path: Path | None, results: list[Any]) -> None:
    """Write results as JSON, where a file is wanted.

    Raises:
        UserError: It cannot be written.
    """
    if path is not None:
        write_text(path, json.dumps([asdict(each) for each in results], indent=1) + "\n")


def main() -> None:
    """Read the command line, whose settings begin with those of the first task, and measure."""
    first_look = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first_look.add_argument("--tasks", nargs="*", default=[])
    tasks = first_look.parse_known_args(sys.argv[1:])[0].tasks or ["flat"]
    defaults = BenchmarkOptions(settings=get_task(tasks[0]))
    config = (tyro.conf.OmitSubcommandPrefixes,)
    options = tyro.cli(BenchmarkOptions[type(defaults.settings)], description=__doc__, default=defaults, config=config)
    options.settings.refuse_idle_changes(defaults.settings)
    if options.time_to_walk:
        time_to_walk(options)
    else:
        benchmark(options)


if __name__ == "__main__":
    run_command(main)
