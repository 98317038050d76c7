"""A page that shows the controller with no server: MuJoCo and ONNX Runtime in the browser; its source is in web/."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import torch

from aicpg_newton.engines.mujoco import MujocoEngine
from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.errors import UserError
from aicpg_newton.export.controller import INPUTS, Controller
from aicpg_newton.export.model import stock_model
from aicpg_newton.export.requirements import SOURCE
from aicpg_newton.files import write_text
from aicpg_newton.playing.attended import TURN_RATE
from aicpg_newton.robot.humanoid import CONTROL_RATE, GRAVITY, LEG_LENGTH

_GROUND = Ground(height_range=0.1, length=32.0, width=32.0, seed=1000)
"""Uneven ground as high as the paper's, of a seed that no training takes by itself."""

_START = 0.9
"""Stride frequency at the start [Hz]."""


def write_page(controller: Controller, folder: Path) -> None:
    """Build the page and write what it needs beside it, but for controller.onnx and humanoid.xml.

    Raises:
        UserError: Node.js is not there, the build fails, or the disk does not take a file.
    """
    _build(folder)
    motors, pattern, physics = controller.motors, controller.pattern, controller.task.physics
    uneven = MujocoEngine(1, "cpu", motors, physics, endless(_GROUND))
    write_text(folder / "humanoid_uneven.xml", stock_model(uneven, motors, pattern))
    frequencies = controller.task.frequencies
    facts = {
        "control_rate": CONTROL_RATE,
        "substeps": physics.substeps,
        "frequency_range": [frequencies.minimum, frequencies.maximum],
        "start_frequency": _START,
        "turn_rate": TURN_RATE,
        "gaits": [{"name": gait.name, "frequency": gait.frequency} for gait in pattern.gaits],
        "leg_length": LEG_LENGTH,
        "gravity": GRAVITY,
        "shapes": {name: shape for name, (shape, _) in INPUTS.items()},
    }
    write_text(folder / "facts.json", json.dumps(facts, indent=2) + "\n")


def endless(ground: Ground) -> Terrain:
    """Two periods of a piece of ground along each axis, so that who leaves the middle can go on a period back.

    Args:
        ground: One period.
    """
    terrain = Terrain.make(ground)
    assert terrain is not None
    heights = terrain.heights[:-1, :-1]
    for axis in (0, 1):
        # The last vertex lies between two random heights, and the first of them is now the first of the next period.
        last, before, first = (heights.select(axis, index) for index in (-1, -2, 0))
        last.copy_(0.5 * (before + first))
    heights = heights.repeat(2, 2)
    heights = torch.cat((heights, heights[:1]), dim=0)
    heights = torch.cat((heights, heights[:, :1]), dim=1)
    return Terrain(replace(ground, length=2 * ground.length, width=2 * ground.width), heights)


def _build(folder: Path) -> None:
    """Fetch the packages that the page is made of, at the versions of its lock file, and bundle them."""
    if not (SOURCE / "node_modules" / ".package-lock.json").is_file():
        print("Fetching the page's packages with npm.", flush=True)
        _run("npm", "ci", "--no-audit", "--no-fund")
    _run("node", "build.mjs", str(folder.resolve()))


def _run(program: str, *arguments: str) -> None:
    command = [shutil.which(program) or program, *arguments]  # npm is a script on Windows, which takes its whole path
    result = subprocess.run(command, cwd=SOURCE, capture_output=True, text=True, check=False)
    if result.returncode:
        lines = (result.stderr or result.stdout).strip().splitlines() or [f"exit status {result.returncode}"]
        raise UserError(
            f"'{program} {arguments[0]}' failed in {SOURCE} ({lines[-1]}); see that npm can fetch the page's packages"
        )
