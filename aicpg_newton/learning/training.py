"""One training run from settings to checkpoints."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import nullcontext, redirect_stdout
from pathlib import Path

from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from aicpg_newton.files import only_one
from aicpg_newton.learning import checkpoint, distributed
from aicpg_newton.learning.bookkeeping import RUNNING, claim, new_folder, release
from aicpg_newton.learning.plan import RunOptions, plan_of


def train(task: Task, options: RunOptions) -> Path:
    """Train the reflex network until ``max_iterations`` are done; with the other processes of a launcher, if any.

    Args:
        task: What is to be learned.
        options: How and where.

    Returns:
        The last checkpoint; in any but the first of several processes the run's folder, as they write nothing.

    Raises:
        UserError: An option cannot be met; nothing has been written then.
    """
    with distributed.joined(), redirect_stdout(None if distributed.rank() else sys.stdout):
        plan = distributed.together(lambda: plan_of(task, options))
        folder = distributed.from_first(lambda: _run_folder(task, options))
        try:
            from aicpg_newton.learning.work import train_in  # here: it takes seconds to load, and options may be wrong

            return _alone_in(folder, lambda: train_in(folder, task, options, plan))
        finally:
            if distributed.rank() == 0:
                release(folder)


def _alone_in(folder: Path, work: Callable[[], Path]) -> Path:
    """Work in a run folder for as long as no other training does; of several processes the first one looks.

    Raises:
        UserError: Another training does.
    """
    with only_one(folder / RUNNING) if distributed.rank() == 0 else nullcontext(True) as alone:

        def look() -> None:
            if not alone:
                raise UserError(f"another process trains in {folder} at this moment; stop it first, or wait for it")

        distributed.together(look)
        for partial in folder.glob("*.pt.partial") if distributed.rank() == 0 else ():
            partial.unlink(missing_ok=True)  # of a process that was killed in the middle of a save
        return work()


def _run_folder(task: Task, options: RunOptions) -> Path:
    """Where the run goes; a folder that holds another run is never written into."""
    if options.run_dir is None and options.resume is not None:
        folder = options.resume if options.resume.is_dir() else options.resume.parent
        last = checkpoint.find(folder).path
        if options.resume.is_file() and last.name != options.resume.name:
            raise UserError(f"{folder} holds later checkpoints up to {last.name}; resume that one, or give --run-dir")
        return folder
    if options.run_dir is None:
        return new_folder(Path("runs") / task.name / task.method)
    claim(options.run_dir)
    return options.run_dir
