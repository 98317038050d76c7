"""Evaluate checkpoints with the paper's protocols: python -m aicpg_newton.evaluate --protocol all --out results."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import tyro

from aicpg_newton.env.registry import get_task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.evaluation.controllers import Controller, cpg_alone, trained
from aicpg_newton.evaluation.protocols import PROTOCOLS, TERRAIN_SEEDS
from aicpg_newton.evaluation.run import Laboratory, evaluate
from aicpg_newton.figures.draw import draw_all
from aicpg_newton.learning import checkpoint
from aicpg_newton.ranges import ENVIRONMENTS, SEED, Range, check_ranges


@dataclass(kw_only=True)
class EvaluateOptions:
    """What to test, how, and where results go."""

    out: Path
    """Folder for CSV, JSON and PNG files. Results in it are never overwritten; figures are drawn anew."""
    checkpoint: tuple[Path, ...] = ()
    """model_*.pt files or run folders, one for each training; the task's shipped checkpoint if none is given."""
    agent: Literal["policy", "zero"] = "policy"
    """policy: the trained network; zero: the CPG alone."""
    task: str | None = None
    """Task to test on; by default the one a checkpoint was trained on, and flat without a checkpoint."""
    engine: str = "auto"
    """newton, mujoco, or auto: newton on CUDA and mujoco on a CPU."""
    device: str = "auto"
    """auto, cpu or cuda:N."""
    num_envs: Annotated[int | None, ENVIRONMENTS] = None
    """Number of environments, shared out evenly among the frequencies; 32 for each, at least 64, when not given."""
    protocol: Literal[
        "sweep", "disturbance", "transition", "slowing", "up_and_down", "speed", "terrain", "training", "all"
    ] = "all"
    """What to do. speed runs the sweep first where there is none; training needs run folders, terrain uneven ground;
    all: all that the ground and the controllers allow, but training."""
    terrain_seed: Annotated[tuple[int, ...], SEED] = ()
    """Seeds of uneven ground (terrain: all of them, other protocols: the first); 1001 to 1005 if none is given."""
    physics_rate: Annotated[int | None, Range(120, 60_000)] = None
    """Physics steps a second [Hz], a multiple of 120; 240, or the rate of the training if that is higher, when not
    given."""
    seed: Annotated[int, SEED] = 0
    """Seed of start states and pushes."""
    redraw: tuple[Path, ...] = ()
    """Only draw figures, into --out, from the CSV files of these folders together."""


def main(options: EvaluateOptions) -> None:
    """Evaluate and draw.

    Raises:
        UserError: An option cannot be met.
    """
    check_ranges(options, "--")
    if options.physics_rate is not None and options.physics_rate % 120:
        raise UserError(f"--physics-rate is {options.physics_rate}; give a multiple of 120")
    if options.redraw:
        for each in fields(options):
            if each.name not in ("out", "redraw") and getattr(options, each.name) != each.default:
                name = each.name.replace("_", "-")
                raise UserError(f"--redraw only draws figures from results that are there; leave --{name} out")
        folders = list(options.redraw)
    else:
        folders = [options.out]
        controllers = _controllers(options)
        uneven = any(controller.task.ground.uneven for controller in controllers)
        if options.terrain_seed and not uneven:
            raise UserError("the ground is a plane; leave --terrain-seed out, or give --task uneven")
        protocols = [
            each
            for name, each in PROTOCOLS.items()
            if options.protocol == name
            or (options.protocol == "all" and not each.whole_training and (uneven or not each.every_terrain))
        ]
        seeds = options.terrain_seed or TERRAIN_SEEDS
        laboratory = Laboratory(
            options.num_envs, options.engine, options.device, options.seed, True, seeds, options.physics_rate
        )
        evaluate(protocols, controllers, laboratory, options.out)
    for path in draw_all(folders, options.out):
        print(f"Figure: {path}")


def _controllers(options: EvaluateOptions) -> list[Controller]:
    """The controllers that the options name."""
    if options.agent == "zero":
        if options.checkpoint:
            raise UserError("--agent zero is the CPG alone; leave --checkpoint out")
        return [cpg_alone(get_task(options.task or "flat"), options.seed)]
    task = None if options.task is None else get_task(options.task)
    if options.checkpoint:
        return [trained(path, task) for path in options.checkpoint]
    return [trained(checkpoint.shipped(get_task(options.task or "flat").name))]


def command() -> None:
    """What ``python -m aicpg_newton.evaluate`` and ``aicpg-evaluate`` do."""
    run_command(lambda: main(tyro.cli(EvaluateOptions, description=__doc__)))


if __name__ == "__main__":
    command()
