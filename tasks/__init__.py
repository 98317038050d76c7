"""Tasks by name. A task is a function that returns a :class:`~aicpg_newton.env.task.Task`; add a file and a line."""

from __future__ import annotations

from collections.abc import Callable

from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from tasks.flat import flat
from tasks.uneven import uneven

TASKS: dict[str, Callable[[], Task]] = {"flat": flat, "uneven": uneven}


def get_task(name: str) -> Task:
    """The task of that name.

    Raises:
        UserError: There is none.
    """
    if name not in TASKS:
        raise UserError(f"unknown task {name!r}; choose one of: {', '.join(TASKS)}")
    return TASKS[name]()
