"""The trained network of a checkpoint, to control an environment with."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable

import torch

from aicpg_newton.env.environment import Environment
from aicpg_newton.learning.runner import Runner

Agent = Callable[[torch.Tensor], torch.Tensor]
"""Observations, shape [num_envs, ...], to actions, shape [num_envs, 28]."""


def load_policy(environment: Environment, trained: dict) -> Agent:
    """The deterministic reflex network of a checkpoint.

    Args:
        environment: The environment it will control, with the checkpoint's task.
        trained: What :func:`checkpoint.read` returned.
    """
    with contextlib.redirect_stdout(io.StringIO()):  # rsl_rl prints the layers of every network it makes
        runner = Runner(environment, trained["run"])
    runner.take_networks(trained, "actor")
    policy = runner.policy()
    return lambda observed: policy({"policy": observed})
