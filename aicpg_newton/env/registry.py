"""Tasks by name: those in ``tasks/``, and those that other installed packages bring."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from aicpg_newton import places
from aicpg_newton.env.methods import DEFAULT_METHOD, with_method
from aicpg_newton.env.stored import brought_up_to_date, updated
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError

GROUP = "aicpg_newton.tasks"
"""Entry points of this group are tasks: a package that declares one brings a task of its own."""


def _own_tasks() -> dict[str, Callable[[], Task]]:
    """The table of ``tasks/__init__.py``, whatever else on the path is called ``tasks``."""
    name = "aicpg_newton.tasks"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(
            name, places.TASKS / "__init__.py", submodule_search_locations=[str(places.TASKS)]
        )
        assert spec is not None and spec.loader is not None
        module = sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return sys.modules[name].TASKS


TASKS = _own_tasks()
"""Tasks of this package by name."""


def get_task(name: str, method: str = DEFAULT_METHOD) -> Task:
    """The task of that name, for a method.

    Args:
        name: A key of :data:`TASKS`, or an entry point of :data:`GROUP`.
        method: As for :func:`~aicpg_newton.env.methods.with_method`.

    Raises:
        UserError: There is no such task or method, or the package that brings the task is broken.
    """
    task = _find(name)
    if task is None:
        known = [*TASKS, *(each.name for each in entry_points(group=GROUP))]
        raise UserError(f"unknown task {name!r}; choose one of: {', '.join(known)}")
    return with_method(task, method)


def task_from_dict(content: Any, source: str) -> Task:
    """Rebuild a task from what :func:`~aicpg_newton.env.stored.to_dict` made of it, as stored in checkpoints.

    Functions of rewards and observations come from the task of that name, or from the package where none has that name.
    Settings that the content does not hold take what was done when it was written, or their default.

    Args:
        content: Nested dictionary.
        source: Where it comes from, for messages.

    Raises:
        UserError: A setting is unknown, out of its range, or has the wrong kind of value.
    """
    if not isinstance(content, dict) or not isinstance(content.get("name"), str):
        raise UserError(f"{source} holds no task of this version; use the version of the code that wrote it")
    content = brought_up_to_date(content)
    name = content["name"]
    method = content.get("method", DEFAULT_METHOD)
    if not isinstance(method, str):
        raise UserError(f"{source} holds {method!r} for method; it is broken, fetch it again")
    task = updated(with_method(_find(name) or Task(name=name), method), content, source)
    try:
        task.validate()
    except UserError as error:
        raise UserError(f"{source} holds settings that cannot be: {error}") from error
    return task


def _find(name: str) -> Task | None:
    """The task of that name before a method makes it complete; None if there is none."""
    if name in TASKS:
        return TASKS[name]()
    brought = tuple(entry_points(group=GROUP, name=name))
    return _brought(brought[0]) if brought else None


def _brought(entry: EntryPoint) -> Task:
    """A task of another package."""
    try:
        task = entry.load()()
    except Exception as error:  # somebody else's code
        raise UserError(f"task {entry.name!r} is declared as {entry.value}, which fails: {error}; mend it") from error
    if not isinstance(task, Task) or task.name != entry.name:
        raise UserError(f"task {entry.name!r} is declared as {entry.value}, which gives no Task of that name; mend it")
    return task
