"""Files of simulations that went wrong, to be stepped again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from aicpg_newton.engines import Engine
from aicpg_newton.env.faults import CAUSES, cause_of
from aicpg_newton.env.registry import task_from_dict
from aicpg_newton.errors import UserError
from aicpg_newton.learning import checkpoint
from aicpg_newton.tensor_files import read_tensors

MOST = 256
"""Robots that a run writes down at most, about 1 kB each."""

_KEYS = {"bad_states", "task", "engine", "iteration", "robots"}


def write(path: Path, robots: dict[str, torch.Tensor], *, task: dict[str, Any], engine: str, iteration: int) -> None:
    """Write what :meth:`aicpg_newton.env.faults.BadStates.take` gave.

    Args:
        path: File to write; it appears whole or not at all.
        robots: Row by row the robot's number, the cause, a snapshot of the engine before the step, and what the step
            was given: ``action`` of the network, ``target``, ``target_velocity``, ``torque`` and, where there was one,
            ``push`` as :meth:`aicpg_newton.engines.Engine.step` takes them.
        task: The task's settings, from :func:`aicpg_newton.env.stored.to_dict`.
        engine: Name of the engine.
        iteration: Iteration of learning in which it happened.

    Raises:
        UserError: The disk does not take it.
    """
    content = {"bad_states": 1, "task": task, "engine": engine, "iteration": iteration, "robots": robots}
    checkpoint.save(content, path)


def read(path: Path) -> dict[str, Any]:
    """Read a file of :func:`write`.

    Raises:
        UserError: It is missing, torn or something else.
    """
    if not path.is_file():
        raise UserError(f"no file at {path}; give a bad_states_*.pt of a run with --dump-bad-states")
    content = read_tensors(path, "bad states", "give another bad_states_*.pt")
    if not isinstance(content, dict) or set(content) != _KEYS:
        raise UserError(f"{path} holds no bad states; give a bad_states_*.pt of a run with --dump-bad-states")
    return content


def step_again(content: dict[str, Any], source: str) -> tuple[Engine, list[str]]:
    """Take the bad steps once more, on the CPU, each robot from its last good state.

    Args:
        content: What :func:`read` returned.
        source: Where it comes from, for messages.

    Returns:
        The engine after the step, and each robot's cause now; empty where the step went well.
    """
    from aicpg_newton.env.environment import engine_for  # here: it takes seconds to load, and a file may be torn

    robots = content["robots"]
    number = len(robots["cause"])
    engine = engine_for(task_from_dict(content["task"], source), content["engine"], number, "cpu")
    engine.restore({name: robots[name] for name in engine.snapshot()})
    engine.step(robots["target"], robots["target_velocity"], robots["torque"], push=robots.get("push"))
    position = engine.state.root_position
    ground = 0.0 if engine.terrain is None else engine.terrain.height(position)
    causes = cause_of(engine.state, position[:, 2] - ground, engine.overflowed)
    return engine, [("", *CAUSES)[cause] for cause in causes.tolist()]
