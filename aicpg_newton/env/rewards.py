"""Reward terms of Eq. 5-8: what each is, its weight, and which of them a task has.

A term is a function of a :class:`~aicpg_newton.env.view.View` that returns shape [num_envs], declared in one of the
tables at the end of this file, or in a task's own file. ``docs/extending.md`` shows how to add one.
"""

from __future__ import annotations

import inspect
import math
import typing
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import torch
import tyro

from aicpg_newton.env.view import View
from aicpg_newton.errors import UserError

PatternError = Literal["sum_of_magnitudes", "magnitude_of_sum"]
"""Reading of Eq. 7: sum_j |e_j|, or |sum_j e_j| as printed, in which errors of opposite sign cancel."""


@dataclass
class RewardTerm:
    """One term of the reward, logged as Episode_Reward/<name>: weighted, mean per step. Of weight 0 it is left out."""

    function: Annotated[Callable[..., torch.Tensor], tyro.conf.Suppress]
    """Takes the view, and the parameters by name; returns shape [num_envs]."""
    weight: float
    """Factor of the term in Eq. 5."""
    parameters: Annotated[dict[str, Any], tyro.conf.arg(name="")] = field(default_factory=dict)
    """Numbers and choices of the function."""

    def __call__(self, view: View) -> torch.Tensor:
        """The term before its weight, shape [num_envs]."""
        return self.function(view, **self.parameters)

    def validate(self, name: str) -> None:
        """Refuse a weight or a parameter that the function cannot take.

        Args:
            name: Dotted name of the term, for messages.

        Raises:
            UserError: A number is not finite, or a parameter is missing, unknown or not one of its choices.
        """
        if not math.isfinite(self.weight):
            raise UserError(f"{name}.weight is {self.weight}; give a finite number")
        wanted = list(inspect.signature(self.function).parameters)[1:]
        if set(wanted) != set(self.parameters):
            raise UserError(f"{name} has the parameters {list(self.parameters)}, but its function takes {wanted}")
        hints = typing.get_type_hints(self.function)
        for parameter, value in self.parameters.items():
            hint = hints.get(parameter)
            choices = typing.get_args(hint) if typing.get_origin(hint) is Literal else None
            if choices is not None and value not in choices:
                raise UserError(f"{name}.{parameter} is {value!r}; choose one of {', '.join(choices)}")
            if hint is float and not (math.isfinite(value) and value > 0.0):
                raise UserError(f"{name}.{parameter} is {value}; give a positive number")


def head_height(view: View) -> torch.Tensor:
    """R_h: height of the head's centre above the ground below it [m]."""
    return view.state.head_position[:, 2] - view.ground_below(view.state.head_position)


def action_energy(view: View, velocity_scale: float) -> torch.Tensor:
    """R_e = sum_j |a_j c w_j| + a_j^2 of the network's torque (Eq. 6): of AI-CPG the reflex alone.

    Args:
        view: Gives a = tau / unit, shape [num_envs, 28], in the unit of :class:`~aicpg_newton.env.task.Reflex`.
        velocity_scale: c [s/rad]; 1 as printed, 0.1 as in Isaac Gym's humanoid.
    """
    action = view.torque / view.torque_unit
    return (torch.abs(action * velocity_scale * view.state.joint_velocity) + action**2).sum(dim=1)


def survival(view: View) -> torch.Tensor:
    """R_a: one for each step survived."""
    return torch.ones_like(view.height)


def upright(view: View) -> torch.Tensor:
    """R_s = z_global . z_pelvis: 1 when the pelvis is upright, 0 when it lies."""
    return view.up


def target_velocity(view: View) -> torch.Tensor:
    """R_d: velocity along the target direction [m/s]."""
    return (view.state.root_linear_velocity[:, :2] * view.direction).sum(dim=1)


def pattern_tracking(view: View, bound: float, reading: PatternError) -> torch.Tensor:
    """R_g = 1 - e/b for e <= b, else 0 (Eq. 8), with the error e of Eq. 7 [rad].

    Args:
        view: With a CPG's target.
        bound: b [rad].
        reading: How e is summed over the joints.
    """
    assert view.target is not None
    errors = view.target - view.state.joint_position
    error = errors.abs().sum(dim=1) if reading == "sum_of_magnitudes" else errors.sum(dim=1).abs()
    return (1.0 - error / bound).clamp_min(0.0)


def target_speed(view: View) -> torch.Tensor:
    """R_t of the PPO baseline: 1 at the speed told, falling straight to 0 at standstill and at twice that speed.

    The paper (Sec. III-A) says only that R_t sets the target velocity; this is the form of its R_g (Eq. 8) with the
    error of the speed for e and the speed told for b. Weighted like R_g it outweighs R_d, which always asks for more.
    """
    wanted = view.commands.speed
    assert wanted is not None
    return (1.0 - (target_velocity(view) - wanted).abs() / wanted).clamp_min(0.0)


def common_terms() -> dict[str, RewardTerm]:
    """Terms that every method has."""
    return {
        "head_height": RewardTerm(head_height, 1.0),
        "action_energy": RewardTerm(action_energy, -0.5, {"velocity_scale": 0.5}),
        "survival": RewardTerm(survival, 1.0),
        "upright": RewardTerm(upright, 1.0),
        "target_velocity": RewardTerm(target_velocity, 1.0),
    }


def pattern_terms() -> dict[str, RewardTerm]:
    """What AI-CPG adds: beta R_g.

    With the magnitude of the sum (``magnitude_of_sum``) errors cancel, and speed stopped following f in a first trial.
    """
    return {
        "pattern_tracking": RewardTerm(pattern_tracking, 5.0, {"bound": 2.5, "reading": "sum_of_magnitudes"}),
    }


def speed_terms() -> dict[str, RewardTerm]:
    """What the PPO baseline has in place of R_g: beta R_t."""
    return {"target_speed": RewardTerm(target_speed, 5.0)}
