"""Train methods side by side and evaluate them together: python -m aicpg_newton.compare --out runs/comparison.

Every training gets the same number of environments and iterations, so the same number of samples. What is finished is
not done again: the same command continues where time ran out.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from aicpg_newton.env.methods import get_method, run_name
from aicpg_newton.env.registry import get_task, task_from_dict
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.evaluation import results
from aicpg_newton.evaluation.controllers import trained
from aicpg_newton.evaluation.protocols import DISTURBANCE, SWEEP, TERRAIN, TRANSITION, Protocol
from aicpg_newton.evaluation.run import Laboratory, evaluate, identity_of
from aicpg_newton.figures.draw import draw_all
from aicpg_newton.files import make_folder, only_one
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.bookkeeping import CONFIG_NAME
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.training import train
from aicpg_newton.ranges import AT_LEAST_ONE, ENVIRONMENTS, POSITIVE, SEED, check_ranges

PAPER = (
    "ai-cpg",
    *(f"ppo:{speed}" for speed in (1.5, 2.0, 2.5, 3.0, 3.5, 4.0)),
    *("amp:walk", "amp:run"),
)
"""Methods and conditions of the paper (Sec. III-A)."""


@dataclass(kw_only=True)
class CompareOptions:
    """Which trainings to compare, how long to train and where to keep it all."""

    out: Path
    """Folder of the comparison: a run folder for each training, and ``evaluation`` once all are done."""
    task: str = "flat"
    """flat or uneven."""
    methods: tuple[str, ...] = PAPER
    """Methods, with the condition after a colon where there is one: ai-cpg ppo:1.5 amp:walk."""
    seeds: Annotated[tuple[int, ...], SEED] = (0, 1, 2, 3, 4)
    """Seeds of each (paper: five)."""
    max_iterations: Annotated[int, AT_LEAST_ONE] = 3000
    """Iterations of each training (paper, Sec. III-A)."""
    max_minutes: Annotated[float | None, POSITIVE] = None
    """Time for everything but the evaluation [min]; the same command goes on from there."""
    save_interval: Annotated[int, AT_LEAST_ONE] = 100
    """Iterations between checkpoints (paper, Sec. III-A)."""
    num_envs: Annotated[int | None, ENVIRONMENTS] = None
    """Number of environments in training; 8192 on CUDA and 256 on a CPU when not given."""
    test_envs: Annotated[int | None, ENVIRONMENTS] = None
    """Number of environments in the evaluation; 32 for each frequency, at least 64, when not given."""
    device: str = "auto"
    """auto, cpu or cuda:N."""
    engine: str = "auto"
    """newton, mujoco, or auto: newton on CUDA and mujoco on a CPU."""


@dataclass
class Training:
    """One of the trainings."""

    task: Task
    seed: int
    folder: Path

    def iterations(self) -> int:
        """Iterations that are done and saved.

        Raises:
            UserError: The folder holds a training with other settings.
        """
        if not (self.folder.is_dir() and any(self.folder.glob("model_*.pt"))):
            return 0
        content = checkpoint.read(self.folder)
        wanted = self.task.for_environments(content["run"]["num_envs"])
        if task_from_dict(content["task"], str(self.folder)) != wanted:
            raise UserError(f"{self.folder} was trained with other settings; give --out another folder or move it away")
        return content["iteration"]


def trainings(options: CompareOptions) -> list[Training]:
    """All trainings, seed by seed, so that every method has had its turn before the next seed.

    Raises:
        UserError: A task or method is unknown, or nothing is to be trained.
    """
    if not options.methods or not options.seeds:
        raise UserError("--methods and --seeds are empty in part; give at least one of each")
    found = []
    for seed in options.seeds:
        for choice in options.methods:
            task = get_task(options.task, choice)
            task = replace(task, learning=replace(task.learning, save_interval=options.save_interval))
            task.validate()
            found.append(Training(task, seed, options.out / f"{run_name(task)}_seed_{seed}"))
    return found


def _follows_frequency(everything: Sequence[Training]) -> bool:
    """Whether any of them can be told a stride frequency."""
    return any(get_method(each.task.method).follows_frequency for each in everything)


def protocols(everything: Sequence[Training]) -> list[Protocol]:
    """What the trainings are compared by (Fig. 3 to 6), as far as their ground and methods allow."""
    found = [SWEEP, DISTURBANCE]
    if _follows_frequency(everything):
        found.append(TRANSITION)
    if any(each.task.ground.uneven for each in everything):
        found.append(TERRAIN)
    return found


def compare(options: CompareOptions) -> bool:
    """Train what is not finished, one after the other, then evaluate all of it together.

    Returns:
        Whether all trainings are finished.

    Raises:
        UserError: An option cannot be met, or the evaluation in the folder is one of other trainings.
    """
    check_ranges(options, "--")
    everything = trainings(options)
    groups = max(each.groups for each in protocols(everything))
    follows = _follows_frequency(everything)
    if options.test_envs is not None and options.test_envs < groups and follows:
        raise UserError(
            f"--test-envs is {options.test_envs}, but the evaluation has {groups} frequencies; give at least one"
            " environment each"
        )
    began = time.monotonic()
    done = [training.iterations() for training in everything]
    at_first = sum(done)

    def show() -> None:
        print(progress(everything, done, options.max_iterations, at_first, time.monotonic() - began))

    for index, training in enumerate(everything):
        left = None if options.max_minutes is None else options.max_minutes - (time.monotonic() - began) / 60
        if left is not None and left <= 0.0:
            break
        make_folder(options.out)
        with only_one(options.out / f".{training.folder.name}.lock") as mine:
            if mine:
                show()
                _train(training, options, left)
                done[index] = training.iterations()
            else:
                print(f"{training.folder.name} is being trained by another job; left to it.")
    done = [training.iterations() for training in everything]  # of those that other jobs were at, too
    show()
    if min(done) < options.max_iterations:
        print("Not all are finished: give the same command again. The evaluation comes when they are.")
        return False
    with only_one(options.out / ".evaluation.lock") as mine:
        if not mine:
            print("All are finished; another job is evaluating them.")
            return True
        return _evaluate(everything, options)


def progress(everything: Sequence[Training], done: Sequence[int], wanted: int, at_first: int, seconds: float) -> str:
    """What is done of each training, a row each, and how long the rest takes at the rate so far.

    Args:
        everything: All trainings.
        done: Iterations that are done of each.
        wanted: Iterations of each.
        at_first: Iterations that were done of all of them together when this job began.
        seconds: Time since then [s].
    """
    lines = [
        f"{training.folder.name:32}{number:6d} of {wanted} iterations"
        for training, number in zip(everything, done, strict=True)
    ]
    left, new = sum(max(0, wanted - number) for number in done), sum(done) - at_first
    if left and new > 0:
        minutes = round(left * seconds / new / 60)
        lines.append(f"{left} iterations are left: about {minutes // 60} h {minutes % 60} min at the rate of this job.")
    return "\n".join(lines)


def _train(training: Training, options: CompareOptions, left: float | None) -> None:
    """Do what is missing of a training that no other job is at.

    Args:
        training: Which.
        options: How long and where.
        left: Time left [min]; None without a limit.
    """
    done = training.iterations()
    if done == 0 and (training.folder / CONFIG_NAME).is_file():
        shutil.rmtree(training.folder)  # it was ended before its first checkpoint: there is nothing to go on from
    if done < options.max_iterations:
        train(
            training.task,
            RunOptions(
                num_envs=options.num_envs,
                device=options.device,
                engine=options.engine,
                max_iterations=options.max_iterations,
                max_minutes=left,
                seed=None if done else training.seed,
                run_dir=None if done else training.folder,
                resume=training.folder if done else None,
            ),
        )


def _evaluate(everything: Sequence[Training], options: CompareOptions) -> bool:
    """Test all trainings together; returns True."""
    folder = options.out / "evaluation"
    laboratory = Laboratory(options.test_envs, options.engine, options.device, show=True)
    controllers = [trained(training.folder) for training in everything]
    if folder.exists():
        results.prepare(folder, (), identity_of(controllers, laboratory))
    missing = [each for each in protocols(everything) if not (folder / f"{each.name}.json").exists()]
    if not missing:
        print(f"Evaluated before: {folder}")
        return True
    evaluate(missing, controllers, laboratory, folder)
    for path in draw_all([folder], folder):
        print(f"Figure: {path}")
    return True


if __name__ == "__main__":
    run_command(lambda: compare(tyro.cli(CompareOptions, description=__doc__)))
