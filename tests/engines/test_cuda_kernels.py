"""Every kernel of a control step and of a reset compiles for NVIDIA GPUs, without one."""

from dataclasses import fields
from pathlib import Path

import pytest
import torch
import warp as wp
from warp._src import context

from aicpg_newton.engines import BodyState, Physics, make_engine
from aicpg_newton.engines.terrain import Ground
from aicpg_newton.robot import humanoid


@pytest.fixture(scope="module")
def modules() -> list[wp.Module]:
    """Warp modules that were loaded to step and reset on a plane and on a terrain: ours, Newton's and MuJoCo Warp's."""
    for ground in (Ground(), Ground(height_range=0.1, length=24.0, width=16.0)):
        engine = make_engine("newton", 2, "cpu", humanoid.motors(), Physics(), ground)
        still = torch.zeros(2, humanoid.NUM_JOINTS)
        engine.step(still, still, still, push=torch.ones(2, 3))
        start = BodyState(**{each.name: getattr(engine.state, each.name) for each in fields(BodyState)})
        engine.reset(torch.tensor([True, False]), start)
    return [module for module in context.user_modules.values() if module.execs]


def test_all_three_sources_are_among_them(modules: list[wp.Module]):
    """Otherwise the slow test below would say little."""
    names = [module.name for module in modules]
    assert len(names) > 50
    for source in ("aicpg_newton.engines.kernels", "newton._src.sim", "mujoco_warp._src.forward", "linesearch"):
        assert any(source in name for name in names), source


@pytest.mark.slow
@pytest.mark.parametrize("architecture", [80, 90, 120], ids=["A100", "H100", "RTX 5090"])
def test_kernels_compile_for_a_gpu(modules: list[wp.Module], tmp_path: Path, architecture: int):
    """To machine code of each generation, by the compiler that comes with Warp."""
    for module in modules:
        wp.compile_aot_module(module, arch=architecture, use_ptx=False, module_dir=str(tmp_path))
    compiled = list(tmp_path.glob(f"*.sm{architecture}.cubin"))
    assert len(compiled) == len(modules)
    assert all(path.stat().st_size > 0 for path in compiled)
