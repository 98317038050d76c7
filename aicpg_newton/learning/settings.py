"""From the task's learning settings to the dictionary that rsl_rl's runner takes."""

from __future__ import annotations

from typing import Any

import torch
from rsl_rl.utils.log_writer import LogWriter
from tensordict import TensorDict

from aicpg_newton.env.environment import Environment
from aicpg_newton.env.methods import get_method
from aicpg_newton.env.task import Task
from aicpg_newton.robot.mirror import JOINTS, Mirror

_EQUIVARIANT = "aicpg_newton.learning.equivariant"


class WithMirrorImages:
    """Appends the left-right mirror image of every sample, as rsl_rl's symmetry extension asks.

    Args:
        mirror: Mirror of the observations.
    """

    def __init__(self, mirror: Mirror) -> None:
        self.mirror = mirror

    def __call__(
        self, env: Environment | None, obs: TensorDict | None, actions: torch.Tensor | None
    ) -> tuple[TensorDict | None, torch.Tensor | None]:
        """Samples and their mirror images.

        Args:
            env: Not needed.
            obs: Observations under the key ``policy``, shape [batch, 192] (136 without a CPG).
            actions: Actions, shape [batch, 28].

        Returns:
            Both with shape [2 batch, ...]: originals first, mirror images after.
        """
        if obs is not None:
            seen = obs["policy"]
            doubled = torch.cat((seen, self.mirror(seen)))
            obs = TensorDict({"policy": doubled}, batch_size=[doubled.shape[0]], device=doubled.device)
        if actions is not None:
            actions = torch.cat((actions, JOINTS(actions)))
        return obs, actions


_LOGGERS: dict[str, Any] = {
    "tensorboard": "tensorboard",
    "wandb": {"class_name": "WandbLogWriter", "project_name": "aicpg_newton"},
    "none": {"class_name": "aicpg_newton.learning.settings:NoLog"},
}


class NoLog(LogWriter):
    """Keeps nothing; rsl_rl saves checkpoints only where there is a log.

    Args:
        log_dir: Not needed.
    """

    def __init__(self, log_dir: str) -> None:
        del log_dir

    def add_scalar(self, tag: str, scalar_value: float, global_step: int) -> None:
        """Drop it."""


def runner_settings(task: Task, mirror: Mirror, seed: int, logger: str = "tensorboard") -> dict[str, Any]:
    """The configuration of rsl_rl's ``OnPolicyRunner``.

    Args:
        task: Task, with the method's name and the learning settings.
        mirror: Mirror of the observations.
        seed: Recorded with the run.
        logger: ``tensorboard``, ``wandb`` (TensorBoard's files too) or ``none``.
    """
    learning, method = task.learning, get_method(task.method)
    equivariant = learning.network == "equivariant"
    network: dict[str, Any] = {
        "class_name": f"{_EQUIVARIANT}:EquivariantModel" if equivariant else "MLPModel",
        "hidden_dims": list(learning.hidden_sizes),
        "activation": learning.activation,
        "obs_normalization": True,
    }
    if equivariant:
        network["mirror"] = mirror
    noise = {
        "class_name": f"{_EQUIVARIANT}:SymmetricGaussian" if equivariant else "GaussianDistribution",
        "init_std": learning.initial_std,
        "std_type": "log",
        "learn_std": learning.learn_std,
    }
    symmetry = {"data_augmentation_func": WithMirrorImages(mirror), "use_data_augmentation": True}
    return {
        "seed": seed,
        "num_steps_per_env": learning.steps_per_iteration,
        "save_interval": learning.save_interval,
        "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
        "logger": _LOGGERS[logger],
        "actor": {**network, "distribution_cfg": noise},
        "critic": {**network, "hidden_dims": list(learning.critic_hidden_sizes or learning.hidden_sizes)},
        "algorithm": {
            "class_name": method.algorithm,
            "num_learning_epochs": learning.epochs,
            "num_mini_batches": learning.minibatches,
            "clip_param": learning.clip,
            "gamma": learning.discount,
            "lam": learning.gae_lambda,
            "value_loss_coef": learning.value_coefficient,
            "use_clipped_value_loss": learning.value_clipping,
            "entropy_coef": learning.entropy_coefficient,
            "learning_rate": learning.learning_rate,
            "max_grad_norm": learning.maximum_gradient_norm,
            "schedule": learning.learning_rate_schedule,
            "learning_rate_bounds": (learning.minimum_learning_rate, learning.maximum_learning_rate),
            "desired_kl": learning.desired_kl,
            "final_kl": learning.final_kl,
            "kl_decay": learning.kl_decay,
            "symmetry_cfg": symmetry if learning.symmetry and not equivariant else None,
            **method.algorithm_settings(task),
        },
    }
