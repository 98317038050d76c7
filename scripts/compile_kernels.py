"""Compile all kernels of a training for a GPU, on a machine without one: python scripts/compile_kernels.py --out cache.

For a GPU that is dear or has no compilers beside it: a first control step spends a minute on compiling there. Sizes of
kernels depend on the number of environments, so give the one that will be trained with. On the machine with the GPU,
with the same versions of the package, Warp and Newton:  WARP_CACHE_PATH=<cache> python train.py ...
"""

from __future__ import annotations

import inspect
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import torch
import tyro
import warp as wp
from warp._src import context

from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.registry import get_task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.evaluation.results import make_folder
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.ranges import ENVIRONMENTS, Range, check_ranges

USUAL_BLOCKS = (32, 128, 256)
"""Threads of a block that Newton's and Warp's kernels are launched with on a GPU where a CPU has blocks of one."""


@dataclass(kw_only=True)
class CompileOptions:
    """What will be trained, and on which GPU."""

    out: Path
    """Folder for the kernels; those of other sizes and architectures that are there stay."""
    tasks: tuple[str, ...] = ("flat",)
    """Tasks that will be trained."""
    num_envs: Annotated[int, ENVIRONMENTS] = 4096
    """Number of environments that will be trained with."""
    architecture: Annotated[int, Range(70, 200)] = 90
    """Compute capability of the GPU: 80 (A100), 89 (RTX 4090), 90 (H100, H200), 120 (RTX 5090)."""


def modules_in_use(tasks: tuple[str, ...], num_envs: int) -> dict[wp.Module, set[int]]:
    """Warp modules that a step and a reset launch, with the sizes of their blocks on a GPU."""
    blocks: dict[wp.Module, set[int]] = defaultdict(set)

    def watched(launch: Any, names: list[str], default: int) -> Any:
        def launched(*arguments: Any, **named: Any) -> Any:
            given = {**dict(zip(names, arguments, strict=False)), **named}
            size = int(given.get("block_dim") or default)
            blocks[given["kernel"].module] |= {size} if size > 1 else set()
            return launch(*arguments, **named)

        return launched

    originals = wp.launch, wp.launch_tiled
    names = list(inspect.signature(wp.launch).parameters)
    try:
        wp.launch = context.launch = watched(originals[0], names, 256)
        wp.launch_tiled = context.launch_tiled = watched(originals[1], names[:1], 1)
        for name in tasks:
            task = get_task(name)
            task.physics.capture = False
            # A new environment has reset all robots.
            environment = Environment(task, engine_for(task, "newton", num_envs, "cpu"), PatternNetwork.load())
            environment.step(torch.zeros(num_envs, environment.num_actions))
    finally:
        wp.launch, wp.launch_tiled = context.launch, context.launch_tiled = originals
    for module in context.user_modules.values():
        if module.execs and not blocks[module]:  # launched with blocks of one, as there is no other on a CPU
            blocks[module] |= set(USUAL_BLOCKS)
    return {module: sizes for module, sizes in blocks.items() if sizes}


def compile_module(module: wp.Module, block: int, architecture: int, cache: Path) -> Path:
    """Compile a module for a size of its blocks, to where Warp looks for it; give its folder."""
    module.get_module_hash(block)  # settles the options for this size
    folder = cache / module.get_module_identifier(block)
    options = module.resolved_options[block]
    module._compile(None, str(folder), output_arch=architecture, use_ptx=False, options=options)
    return folder


def main(options: CompileOptions) -> None:
    """Compile and tell how far it is.

    Raises:
        UserError: A task is unknown, or the folder cannot be made.
    """
    check_ranges(options, "--")
    if not options.tasks:
        raise UserError("--tasks is empty; give at least one")
    for name in options.tasks:
        get_task(name)
    make_folder(options.out)
    began = time.perf_counter()
    modules = modules_in_use(options.tasks, options.num_envs)
    jobs = [(module, block) for module, blocks in modules.items() for block in sorted(blocks)]
    for number, (module, block) in enumerate(jobs, start=1):
        try:
            compile_module(module, block, options.architecture, options.out)
        except Exception as error:  # a size that a module cannot have is none that it is launched with
            print(f"{module.name}, blocks of {block}: left out ({str(error).splitlines()[0][:100]})")
        if number % 10 == 0 or number == len(jobs):
            print(f"{number} of {len(jobs)} kernels' modules after {time.perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    run_command(lambda: main(tyro.cli(CompileOptions, description=__doc__)))
