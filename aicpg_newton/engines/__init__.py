"""Physics engines behind one small interface: batched tensors in, batched tensors out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch

from aicpg_newton.device import resolve_device
from aicpg_newton.engines.interface import BodyState, Engine, Physics, RobotState, StepMeasures
from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.errors import UserError
from aicpg_newton.robot.humanoid import Motors

__all__ = ["ENGINES", "BodyState", "Engine", "Physics", "RobotState", "StepMeasures", "engine_name", "make_engine"]


class _EngineClass(Protocol):
    def __call__(
        self,
        num_envs: int,
        device: torch.device,
        motors: Motors,
        physics: Physics,
        terrain: Terrain | None = None,
    ) -> Engine: ...


# The engines are imported on first use: Warp and MuJoCo take seconds to load, and nobody needs both.


def _newton() -> _EngineClass:
    from aicpg_newton.engines.newton import NewtonEngine

    return NewtonEngine


def _mujoco() -> _EngineClass:
    from aicpg_newton.engines.mujoco import MujocoEngine

    return MujocoEngine


ENGINES: dict[str, Callable[[], _EngineClass]] = {
    "newton": _newton,
    "mujoco": _mujoco,
}
"""Name of each engine to a function that imports and returns its class."""


def engine_name(name: str, device: torch.device) -> str:
    """Name of the engine to use.

    Args:
        name: A key of :data:`ENGINES`, or ``auto``: newton on CUDA, mujoco on the CPU.
        device: Device of the physics.

    Raises:
        UserError: There is no such engine.
    """
    if name == "auto":
        return "newton" if device.type == "cuda" else "mujoco"
    if name not in ENGINES:
        raise UserError(f"there is no engine {name!r}; choose one of {', '.join(('auto', *ENGINES))}")
    return name


def make_engine(
    name: str,
    num_envs: int,
    device: torch.device | str,
    motors: Motors,
    physics: Physics,
    ground: Ground | None = None,
) -> Engine:
    """Make an engine by name.

    Args:
        name: As for :func:`engine_name`.
        num_envs: Number of humanoids.
        device: Torch device, ``cuda:0`` or ``cpu``.
        motors: Gains, limits, damping and armature per joint.
        physics: Simulation settings.
        ground: Shape of the ground; a plane when none is given.

    Raises:
        UserError: There is no such engine or device, the engine cannot run on the device, or a number is out of range.
    """
    device = resolve_device(str(device))
    engine = ENGINES[engine_name(name, device)]
    if num_envs < 1:
        raise UserError(f"num_envs is {num_envs}; give at least one environment")
    physics.validate()
    terrain = None if ground is None else Terrain.make(ground)
    return engine()(num_envs, device, motors, physics, terrain)
