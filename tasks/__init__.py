"""Tasks by name. A task is a function that returns a :class:`~aicpg_newton.env.task.Task`; add a file and a line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from aicpg_newton.env.methods import DEFAULT_METHOD, with_method
from aicpg_newton.env.stored import brought_up_to_date, updated
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from tasks.flat import flat
from tasks.robust import robust
from tasks.uneven import uneven

TASKS: dict[str, Callable[[], Task]] = {"flat": flat, "uneven": uneven, "robust": robust}


def get_task(name: str, method: str = DEFAULT_METHOD) -> Task:
    """The task of that name, for a method.

    Args:
        name: A key of :data:`TASKS`.
        method: As for :func:`~aicpg_newton.env.methods.with_method`.

    Raises:
        UserError: There is no such task or method.
    """
    if name not in TASKS:
        raise UserError(f"unknown task {name!r}; choose one of: {', '.join(TASKS)}")
    return with_method(TASKS[name](), method)


def task_from_dict(content: Any, source: str) -> Task:
    """Rebuild a task from what :func:`~aicpg_newton.env.stored.to_dict` made of it, as stored in checkpoints.

    Functions of rewards and observations come from the task of that name, or from the package where none has that name.
    Settings that the content does not hold take what was done when it was written, or their default.

    Args:
        content: Nested dictionary.
        source: Where it comes from, for messages.

    Raises:
        UserError: A setting is unknown, or has the wrong kind of value.
    """
    if not isinstance(content, dict) or not isinstance(content.get("name"), str):
        raise UserError(f"{source} holds no task of this version; use the version of the code that wrote it")
    content = brought_up_to_date(content)
    name = content["name"]
    plain = TASKS[name]() if name in TASKS else Task(name=name)
    return updated(with_method(plain, content.get("method", DEFAULT_METHOD)), content, source)
