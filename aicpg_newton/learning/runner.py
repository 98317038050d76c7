"""rsl_rl's on-policy runner with this project's checkpoints: whole files, exact resume."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from rsl_rl.runners import OnPolicyRunner

from aicpg_newton import checkpoint
from aicpg_newton.environment import Environment
from aicpg_newton.errors import UserError
from aicpg_newton.learning.settings import runner_settings


class Runner(OnPolicyRunner):
    """Trains the reflex network of an environment, or loads one to play.

    Args:
        environment: The environment; its task holds the learning settings.
        run: Facts about the run that go into every checkpoint (number of environments, engine, seed, revision).
        folder: Where logs and checkpoints go; None to log and save nothing.
    """

    env: Environment

    def __init__(self, environment: Environment, run: dict[str, Any], folder: Path | None = None) -> None:
        self.run = run
        settings = runner_settings(environment.task.learning, run["seed"])
        log_dir = None if folder is None else str(folder)
        super().__init__(environment, settings, log_dir=log_dir, device=str(environment.device))
        # rsl_rl keeps the revision and the uncommitted changes of this project with the run.
        self.logger.git_status_repos = [__file__]

    def save(self, path: str, infos: dict | None = None) -> None:
        """Write a checkpoint after the current iteration."""
        checkpoint.write(
            Path(path),
            task=asdict(self.env.task),
            pattern=self.env.pattern.content(),
            run=self.run,
            iteration=self.current_learning_iteration + 1,
            samples=self.logger.tot_timesteps,
            algorithm=self.alg.save(),
        )

    def restore(self, content: dict[str, Any], *, play_only: bool = False) -> None:
        """Continue from a checkpoint: networks, normalisers, optimiser with its learning rate, iteration, samples.

        Args:
            content: What :func:`checkpoint.read` returned.
            play_only: Load the actor and its normaliser alone.

        Raises:
            UserError: The checkpoint's networks have other sizes than the task's settings.
        """
        try:
            self.alg.load(content["algorithm"], load_cfg={"actor": True} if play_only else None, strict=True)
        except (RuntimeError, ValueError, KeyError) as error:
            raise UserError(
                "the checkpoint's networks do not fit the settings; leave learning.hidden-sizes and"
                " learning.activation as they were"
            ) from error
        self.current_learning_iteration = content["iteration"]
        self.logger.tot_timesteps = content["samples"]

    def policy(self) -> torch.nn.Module:
        """The reflex network for deterministic use: observations [num_envs, 192] to actions [num_envs, 28]."""
        return self.get_inference_policy(str(self.env.device))
