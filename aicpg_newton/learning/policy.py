"""A trained network and what it was trained with, from its checkpoint."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from aicpg_newton.env.registry import task_from_dict
from aicpg_newton.env.task import Task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning import checkpoint

if TYPE_CHECKING:
    from aicpg_newton.env.environment import Environment

Agent = Callable[[torch.Tensor], torch.Tensor]
"""Observations, shape [num_envs, ...], to actions, shape [num_envs, 28]."""


@dataclass
class Trained:
    """What a checkpoint holds, as objects."""

    path: Path
    """Where it was read from."""
    content: dict[str, Any]
    """What :func:`checkpoint.read` returned."""
    task: Task
    """Task it was trained on."""
    pattern: PatternNetwork
    """The pattern network S beside it."""

    @classmethod
    def read(cls, path: Path) -> Trained:
        """Read a checkpoint, or a run folder's latest.

        Raises:
            UserError: It is missing, torn or of another version.
        """
        content = checkpoint.read(path)
        task = task_from_dict(content["task"], str(path))
        return cls(path, content, task, PatternNetwork.from_content(content["pattern"], str(path)))


def load_network(environment: Environment, trained: dict[str, Any]) -> torch.nn.Module:
    """The deterministic network of a checkpoint; takes a dictionary with the observations under ``policy``.

    Args:
        environment: The environment it will control, with the checkpoint's task.
        trained: What :func:`checkpoint.read` returned.

    Raises:
        UserError: The network does not fit the environment.
    """
    from aicpg_newton.learning.runner import Runner  # here: rsl_rl takes seconds to load, and a file may be torn

    with contextlib.redirect_stdout(io.StringIO()):  # rsl_rl prints the layers of every network it makes
        runner = Runner(environment, trained["run"])
    runner.take_networks(trained, "actor")
    return runner.policy()


def load_policy(environment: Environment, trained: dict[str, Any]) -> Agent:
    """The same as an agent; arguments and errors as for :func:`load_network`."""
    network = load_network(environment, trained)
    return lambda observed: network({"policy": observed})
