"""Which humanoid this is: a fingerprint of its facts, so that networks of another one are not taken for its own."""

# MuJoCo's extension module has no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from aicpg_newton.robot import humanoid
from aicpg_newton.robot.humanoid import MJCF_PATH
from aicpg_newton.robot.mjcf import checked

_BODY = ("body_mass", "body_ipos", "body_pos", "body_quat")
_JOINT = ("jnt_type", "jnt_axis", "jnt_pos", "jnt_limited", "jnt_range", "jnt_stiffness")
_GEOM = ("geom_type", "geom_size", "geom_pos", "geom_quat", "geom_contype", "geom_conaffinity")
_TABLES = ("JOINT_NAMES", "LINK_NAMES", "FOOT_NAMES", "HAND_LINKS", "HEAD_CENTRE", "HAND_CENTRE", "CONTROL_RATE")
"""Of :mod:`aicpg_newton.robot.humanoid`, beside the gains."""


@cache
def fingerprint(path: Path = MJCF_PATH) -> str:
    """Twelve hexadecimal digits of the robot's facts, stored in checkpoints.

    Facts are what the file means, not how it is written: comments, line endings, the order of its bodies and the last
    digits of a computation do not count. Gains, limits, and where head and hands are belong to them; damping, armature
    and friction of the file do not, as other tables stand in their place.

    Args:
        path: The MJCF.

    Raises:
        UserError: The file is no MJCF, or names other files.
    """
    return hashlib.sha256("\n".join(facts(path)).encode()).hexdigest()[:12]


def facts(path: Path = MJCF_PATH) -> list[str]:
    """The facts, a line each; see :func:`fingerprint`."""
    model = checked(path).compile()
    bodies = [model.body(index).name for index in range(model.nbody)]
    named = [
        (f"body {name} of {bodies[parent]}", index, _BODY)
        for index, (name, parent) in enumerate(zip(bodies, model.body_parentid, strict=True))
    ]
    for kind, fields, count, element, body in (
        ("joint", _JOINT, model.njnt, model.joint, model.jnt_bodyid),
        ("geom", _GEOM, model.ngeom, model.geom, model.geom_bodyid),
    ):
        named += [(f"{kind} {element(index).name} of {bodies[body[index]]}", index, fields) for index in range(count)]
    lines = [
        f"{name}: " + " ".join(f"{field}={_text(getattr(model, field)[index])}" for field in fields)
        for name, index, fields in named
    ]
    lines += [f"body {name}: inertia={_text(_inertia(model, index))}" for index, name in enumerate(bodies)]
    table = [f"{name}: {group}" for name, group in humanoid.JOINT_GROUPS.items()]
    order = [f"{name} = {getattr(humanoid, name)}" for name in _TABLES]
    return [*sorted(lines), *table, *order]


def _inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Inertia of a body about its centre of mass [kg m^2]: of a sphere the principal axes are anybody's guess."""
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    rotation = axes.reshape(3, 3)
    return (rotation * model.body_inertia[body]) @ rotation.T


def _text(values: Any) -> str:
    """Numbers to seven digits, those near zero as zero."""
    numbers = np.ravel(np.asarray(values, dtype=float))
    return ",".join(f"{0.0 if abs(number) < 1e-9 else number:.7g}" for number in numbers)
