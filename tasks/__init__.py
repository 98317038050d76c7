"""The tasks that come with aicpg_newton, by name: a function each that returns a Task. Add a file and a line."""

from __future__ import annotations

from collections.abc import Callable

from aicpg_newton.env.task import Task

from .flat import flat
from .robust import robust
from .uneven import uneven

TASKS: dict[str, Callable[[], Task]] = {"flat": flat, "uneven": uneven, "robust": robust}
