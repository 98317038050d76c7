"""Engines by name, and what a user is told when there is no such thing."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

from aicpg_newton.engines import Physics, make_engine
from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.errors import UserError
from aicpg_newton.robot.humanoid import motors


def test_unknown_engine_lists_the_choices() -> None:
    """A misspelt engine is answered with the names that exist."""
    with pytest.raises(UserError, match="auto, newton, mujoco"):
        make_engine("bullet", 2, "cpu", motors(), Physics())


@pytest.mark.parametrize("device", ["cuda:99", "gpu"])
def test_missing_device(device: str) -> None:
    """A device that this machine lacks, or nobody has, is refused before anything is built."""
    with pytest.raises(UserError, match=device):
        make_engine("auto", 2, device, motors(), Physics())


def test_cuda_without_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a machine without a GPU, asking for CUDA is refused in one sentence."""
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    for name in ("auto", "newton"):
        with pytest.raises(UserError, match="cuda"):
            make_engine(name, 2, "cuda", motors(), Physics())


def test_mujoco_refuses_cuda() -> None:
    """The CPU engine says so on a CUDA device instead of moving tensors behind the user's back."""
    from aicpg_newton.engines.mujoco import MujocoEngine

    with pytest.raises(UserError, match="use cpu"):
        MujocoEngine(2, "cuda:0", motors(), Physics())


@pytest.mark.parametrize(("num_envs", "physics"), [(0, Physics()), (2, Physics(substeps=3)), (2, Physics(friction=-1))])
def test_bad_numbers(num_envs: int, physics: Physics) -> None:
    """Settings that no engine can run are refused."""
    with pytest.raises(UserError):
        make_engine("mujoco", num_envs, "cpu", motors(), physics)


def test_auto_is_mujoco_on_the_cpu() -> None:
    """Without a GPU, ``auto`` takes the engine that uses all cores."""
    assert make_engine("auto", 1, "cpu", motors(), Physics()).name == "mujoco"


def test_ground_becomes_terrain() -> None:
    """The engine holds the terrain of the settings it was given; none and no height are a plane."""
    ground = Ground(height_range=0.1, length=10.0, width=8.0)
    terrain = make_engine("mujoco", 1, "cpu", motors(), Physics(), ground).terrain
    expected = Terrain.make(ground)
    assert terrain is not None and expected is not None and torch.equal(terrain.heights, expected.heights)
    assert make_engine("mujoco", 1, "cpu", motors(), Physics()).terrain is None
    assert make_engine("mujoco", 1, "cpu", motors(), Physics(), Ground()).terrain is None


def test_bad_ground() -> None:
    """Ground that cannot be built is refused like any other setting."""
    with pytest.raises(UserError, match=r"ground\.cell"):
        make_engine("mujoco", 1, "cpu", motors(), Physics(), Ground(height_range=0.1, cell=0.0))


def test_import_is_light() -> None:
    """Naming the engines loads neither Warp nor MuJoCo."""
    code = "import sys, aicpg_newton.engines; print([m for m in ('warp', 'newton', 'mujoco') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
