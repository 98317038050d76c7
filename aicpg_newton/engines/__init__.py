"""Physics engines behind one small interface: batched tensors in, batched tensors out."""

from __future__ import annotations

from collections.abc import Callable

import torch

from aicpg_newton.device import resolve_device
from aicpg_newton.engines.interface import Engine, Physics, RobotState
from aicpg_newton.errors import UserError
from aicpg_newton.humanoid import Motors

__all__ = ["ENGINES", "Engine", "Physics", "RobotState", "make_engine"]

# The engines are imported on first use: Warp and MuJoCo take seconds to load, and nobody needs both.


def _newton() -> Callable[[int, torch.device, Motors, Physics], Engine]:
    from aicpg_newton.engines.newton import NewtonEngine

    return NewtonEngine


def _mujoco() -> Callable[[int, torch.device, Motors, Physics], Engine]:
    from aicpg_newton.engines.mujoco import MujocoEngine

    return MujocoEngine


ENGINES: dict[str, Callable[[], Callable[[int, torch.device, Motors, Physics], Engine]]] = {
    "newton": _newton,
    "mujoco": _mujoco,
}
"""Name of each engine to a function that imports and returns its class."""


def make_engine(name: str, num_envs: int, device: torch.device | str, motors: Motors, physics: Physics) -> Engine:
    """Make an engine by name.

    Args:
        name: A key of :data:`ENGINES`, or ``auto``: newton on CUDA, mujoco on the CPU.
        num_envs: Number of humanoids.
        device: Torch device, ``cuda:0`` or ``cpu``.
        motors: Gains, limits, damping and armature per joint.
        physics: Simulation settings.

    Raises:
        UserError: There is no such engine or device, the engine cannot run on the device, or a number is out of range.
    """
    if name != "auto" and name not in ENGINES:
        raise UserError(f"there is no engine {name!r}; choose one of {', '.join(('auto', *ENGINES))}")
    if num_envs < 1:
        raise UserError(f"num_envs is {num_envs}; give at least one environment")
    physics.validate()
    device = resolve_device(str(device))
    if name == "auto":
        name = "newton" if device.type == "cuda" else "mujoco"
    return ENGINES[name]()(num_envs, device, motors, physics)
