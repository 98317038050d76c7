"""The script that compiles kernels for a GPU without one."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SCRIPT = ROOT / "scripts" / "compile_kernels.py"


def test_modules_and_their_blocks(tmp_path: Path):
    """All three sources, our own launched with 256 threads a block; compiled to where Warp looks for it."""
    specification = importlib.util.spec_from_file_location("compile_kernels", SCRIPT)
    assert specification is not None and specification.loader is not None
    script = importlib.util.module_from_spec(specification)
    sys.modules["compile_kernels"] = script
    specification.loader.exec_module(script)
    modules = script.modules_in_use(("flat",), 2)
    names = {module.name: blocks for module, blocks in modules.items()}
    assert len(names) > 40 and all(blocks and min(blocks) > 1 for blocks in names.values())
    for source in ("newton._src.sim", "mujoco_warp._src.forward", "linesearch"):
        assert any(source in name for name in names), source
    assert names["aicpg_newton.engines.kernels"] == {256}
    own = next(module for module in modules if module.name == "aicpg_newton.engines.kernels")
    folder = script.compile_module(own, 256, 90, tmp_path)
    assert folder.name == own.get_module_identifier(256) and folder.parent == tmp_path
    assert [path.stat().st_size > 1000 for path in folder.glob("*.sm90.cubin")] == [True]
    assert len(list(folder.glob("*.meta"))) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tasks", "moon"], "unknown task 'moon'"),
        (["--tasks"], "--tasks is empty"),
        (["--architecture", "9"], "--architecture is 9"),
        (["--num-envs", "0"], "--num-envs is 0"),
    ],
)
def test_bad_input(arguments: list[str], message: str, tmp_path: Path):
    """One sentence, and no folder."""
    command = [sys.executable, str(SCRIPT), "--out", str(tmp_path / "cache"), *arguments]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 2 and message in result.stderr and "Traceback" not in result.stderr
    assert not (tmp_path / "cache").exists()
