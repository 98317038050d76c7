"""Parts of gpu_check.sh: versions, captured against uncaptured, parity with the CPU engine, a step's profile."""

from __future__ import annotations

import importlib.metadata
import platform
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import torch
import tyro

from aicpg_newton.device import finish, resolve_device, worth_compiling
from aicpg_newton.engines import BodyState
from aicpg_newton.engines.terrain import Ground
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.gait.cpg import PatternNetwork

GROUNDS = {"plane": Ground(), "terrain": Ground(height_range=0.1, length=24.0, width=16.0)}
WORLDS = 16
STEPS = 60


@dataclass
class Options:
    """Which part, and on which device."""

    part: Annotated[Literal["versions", "captured", "parity", "profile"], tyro.conf.Positional]
    device: str = "cuda:0"
    num_envs: int = 4096
    """Number of environments to profile with."""


def main(options: Options) -> None:
    """Do one part.

    Raises:
        UserError: The device is not there, or the part found something wrong.
    """
    device = resolve_device(options.device)
    if options.part == "profile":
        profile(device, options.num_envs)
    else:
        {"versions": versions, "captured": captured, "parity": parity}[options.part](device)


def versions(device: torch.device) -> None:
    """Device, driver and packages."""
    names = ("torch", "warp-lang", "newton", "mujoco", "mujoco-warp", "rsl-rl-lib", "numpy")
    print("python", platform.python_version())
    for name in names:
        print(name, importlib.metadata.version(name))
    if device.type == "cuda":
        free, total = torch.cuda.mem_get_info(device)
        print(
            torch.cuda.get_device_name(device),
            f"CUDA {torch.version.cuda}, {free / 2**30:.0f} of {total / 2**30:.0f} GiB free",
        )
    else:
        print(f"CPU, {torch.get_num_threads()} threads")


def captured(device: torch.device) -> None:
    """Steps that are replayed against steps whose kernels are launched one by one."""
    for title, ground in GROUNDS.items():
        ends = []
        for capture in (True, False):
            task = _task(ground)
            task.physics.capture = capture
            environment = Environment(task, engine_for(task, "newton", WORLDS, device), PatternNetwork.load(), seed=2)
            generator = torch.Generator().manual_seed(3)
            for _ in range(STEPS):
                observed, *_ = environment.step(0.4 * torch.randn(WORLDS, 28, generator=generator).to(device))
            ends.append(observed["policy"])
        print(f"{title}: largest difference after {STEPS} steps {(ends[0] - ends[1]).abs().max().item():.3g}")
        # The order in which a GPU adds up contact forces is not fixed; on a CPU it is.
        if device.type == "cpu" and not torch.equal(*ends):
            raise UserError(
                "replayed steps differ from those launched one by one; give --physics.no-capture and report it"
            )


def parity(device: torch.device) -> None:
    """A quarter of a second of walking against MuJoCo on the CPU, from the same states."""
    for title, ground in GROUNDS.items():
        task = _task(ground)
        pattern = PatternNetwork.load()
        reference = Environment(task, engine_for(task, "mujoco", WORLDS, "cpu"), pattern, seed=4)
        start = BodyState(**{name: getattr(reference.engine.state, name) for name in BodyState.__dataclass_fields__})
        engine = engine_for(task, "newton", WORLDS, device)
        engine.reset(
            torch.ones(WORLDS, dtype=torch.bool, device=device),
            BodyState(**{name: value.to(device) for name, value in vars(start).items()}),
        )
        phase, frequency = reference.phase, reference.commands.frequency
        still = torch.zeros(WORLDS, 28)
        for _ in range(15):
            target, rate = pattern.target(phase, frequency)
            reference.engine.step(target, rate, still)
            engine.step(target.to(device), rate.to(device), still.to(device))
        off = (engine.state.root_position.cpu() - reference.engine.state.root_position).norm(dim=1)
        median, worst = off.median().item() * 1e3, off.max().item() * 1e3
        print(f"{title}: root {median:.3f} mm off in the median, {worst:.1f} mm in the worst")
        if not off.median() < 0.02:
            raise UserError(
                "the engines differ by more than 2 cm after a quarter of a second; do not train on this one"
            )


def profile(device: torch.device, num_envs: int) -> None:
    """What a control step spends its time on."""
    task = get_task("flat")
    engine, compiled = engine_for(task, "newton", num_envs, device), worth_compiling("auto", device)
    environment = Environment(task, engine, PatternNetwork.load(), compiled=compiled)
    actions = torch.zeros(num_envs, 28, device=device)
    for _ in range(5):
        environment.step(actions)
    finish(device)
    kinds = [torch.profiler.ProfilerActivity.CPU]
    if device.type == "cuda":
        kinds.append(torch.profiler.ProfilerActivity.CUDA)
    with torch.profiler.profile(activities=kinds) as found:
        for _ in range(20):
            environment.step(actions)
        finish(device)
    order = "self_cuda_time_total" if device.type == "cuda" else "self_cpu_time_total"
    print(found.key_averages().table(sort_by=order, row_limit=25, max_name_column_width=60))


def _task(ground: Ground) -> Task:
    task = get_task("flat")
    task.ground = ground
    return task


if __name__ == "__main__":
    run_command(lambda: main(tyro.cli(Options, description=__doc__)))
