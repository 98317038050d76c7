"""Memory of an environment and how full contact and constraint buffers get: python scripts/memory.py. See --help."""

from __future__ import annotations

import contextlib
import gc
import io
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch
import tyro
import warp as wp

from aicpg_newton.device import resolve_device, torch_threads
from aicpg_newton.engines.newton import NewtonEngine
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.registry import get_task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.policy import Trained, load_policy
from aicpg_newton.learning.runner import Runner
from aicpg_newton.robot.humanoid import CONTROL_RATE, NUM_JOINTS


@dataclass
class Options:
    """What to measure."""

    tasks: tuple[str, ...] = ("flat", "uneven")
    engines: tuple[str, ...] = ("newton", "mujoco")
    num_envs: tuple[int, ...] = (64, 1024)
    """Numbers of environments; what one more takes is the slope from the least to the greatest."""
    extrapolate: tuple[int, ...] = (8192, 16384, 32768)
    device: str = "auto"
    buffer_envs: int = 32
    """Robots that fill the buffers."""
    buffer_seconds: float = 8.0
    """Time for which they do [s]; 0 leaves the buffers out."""


def main(options: Options) -> None:
    """Measure, and print Markdown tables.

    Raises:
        UserError: An option cannot be met.
    """
    if len(set(options.num_envs)) < 2 or min(options.num_envs) < 1:
        raise UserError(f"--num-envs is {options.num_envs}; give at least two different positive numbers")
    device = resolve_device(options.device)
    rows = [
        [engine, task, *memory(task, engine, options, device)] for engine in options.engines for task in options.tasks
    ]
    totals = [f"{number} [GB]" for number in options.extrapolate]
    head = ["engine", "task", "fixed [MB]", "physics [kB]", "environment [kB]", "learning [kB]", "update [kB]", *totals]
    print_table(head, rows)
    if options.buffer_seconds > 0.0:
        print()
        rows = [row for task in options.tasks for row in buffers(task, options, device)]
        print_table(["task", "robots", "contacts", "most of a robot", "constraints", "overflows"], rows)


def memory(task: str, engine: str, options: Options, device: torch.device) -> list[str]:
    """What does not depend on the number of environments, what each of them takes, and what so many take."""
    least, most = min(options.num_envs), max(options.num_envs)
    parts = {number: _parts(task, engine, number, device) for number in sorted({*options.num_envs})}
    each = [(high - low) / (most - least) for low, high in zip(parts[least], parts[most], strict=True)]
    fixed = sum(parts[least]) - least * sum(each)
    totals = [f"{(fixed + number * sum(each)) / 1e9:.2f}" for number in options.extrapolate]
    return [f"{fixed / 1e6:.0f}", *(f"{size / 1e3:.1f}" for size in each), *totals]


def _parts(task: str, engine_name: str, num_envs: int, device: torch.device) -> tuple[int, int, int, int]:
    """Bytes in the arrays of physics, environment and learning after a step, and of what an update keeps at most."""
    chosen = get_task(task)
    nothing = _arrays()
    engine = engine_for(chosen, engine_name, num_envs, device)
    own = [each for each in vars(engine).values() if isinstance(each, np.ndarray) and each.flags.owndata]
    physics = _arrays(own)
    environment = Environment(chosen, engine, PatternNetwork.load())
    environment.step(torch.zeros(num_envs, NUM_JOINTS, device=device))
    around = _arrays(own)
    with contextlib.redirect_stdout(io.StringIO()):
        runner = Runner(environment, {"seed": 0})
    learning = _arrays(own)
    return physics - nothing, around - physics, learning - around, _kept_by_an_update(runner)


def _kept_by_an_update(runner: Runner) -> int:
    """Bytes that back-propagation keeps of a minibatch until its gradients are there; the largest minibatch counts."""
    kept: dict[int, int] = {}
    most = 0

    def keep(tensor: torch.Tensor) -> torch.Tensor:
        nonlocal most
        kept[tensor.untyped_storage().data_ptr()] = tensor.untyped_storage().nbytes()
        most = max(most, sum(kept.values()))
        return tensor

    runner.alg.optimizer.register_step_post_hook(lambda *_: kept.clear())
    hooks = torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor)
    with hooks, contextlib.redirect_stdout(io.StringIO()):
        runner.learn(1)
    return most


def _arrays(of_numpy: Iterable[np.ndarray] = ()) -> int:
    """Bytes in all arrays of Warp and torch that there are, and in some of NumPy, each counted once."""
    gc.collect()
    found = {each.ctypes.data: each.nbytes for each in of_numpy}
    # Exact types: some objects answer isinstance with a warning.
    for each in gc.get_objects():
        if type(each) is wp.array and each.ptr and each.deleter is not None:
            found[each.ptr] = max(found.get(each.ptr, 0), each.capacity)
    for each in gc.get_objects():
        if issubclass(type(each), torch.Tensor) and each.layout == torch.strided:
            storage = each.untyped_storage()
            found.setdefault(storage.data_ptr(), storage.nbytes())
    return sum(found.values())


def buffers(name: str, options: Options, device: torch.device) -> list[list[str]]:
    """How full the buffers get with trained robots, with random actions, and with robots that nobody resets."""
    trained = Trained.read(checkpoint.best_for(name))
    task = get_task(name)
    found = []
    for title in ("trained", "random actions", "lying"):
        if title == "lying":
            task.termination.minimum_height, task.termination.maximum_tilt = 0.0, 180.0
            task.termination.maximum_heading = 180.0
        engine = engine_for(task, "newton", options.buffer_envs, device)
        assert isinstance(engine, NewtonEngine)
        environment = Environment(task, engine, trained.pattern)
        policy = load_policy(environment, trained.content) if title == "trained" else _random
        most = _run(environment, engine, policy, round(options.buffer_seconds * CONTROL_RATE))
        marks = engine.high_water()
        cells = (f"{marks['contacts']:.1f}", str(most), f"{marks['constraints']:.0f}", str(engine.overflows()))
        found.append([name, title, *cells])
    limits = get_task(name).physics
    found.append([name, "room for", str(limits.max_contacts), "", str(limits.max_constraints), ""])
    return found


def _random(observed: torch.Tensor) -> torch.Tensor:
    return torch.randn(len(observed), NUM_JOINTS, device=observed.device)


@torch_threads(1)
def _run(
    environment: Environment, engine: NewtonEngine, policy: Callable[[torch.Tensor], torch.Tensor], steps: int
) -> int:
    """The most contacts that one robot had at the end of a control step."""
    most, data = 0, engine.solver.mjw_data
    for _ in range(steps):
        environment.step(policy(environment.get_observations()["policy"]))
        number = int(data.nacon.numpy()[0])
        worlds = data.contact.worldid.numpy()[:number]
        most = max(most, int(np.bincount(worlds).max(initial=0)))
    return most


def print_table(head: list[str], rows: list[list[str]]) -> None:
    """Print a Markdown table."""
    for line in (head, ["---"] * len(head), *rows):
        print(f"| {' | '.join(line)} |")


if __name__ == "__main__":
    run_command(lambda: main(tyro.cli(Options, description=__doc__)))
