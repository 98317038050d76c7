"""The folder of compiled kernels cannot be written to, as where HOME is read-only."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

WORK = """
import tempfile
from aicpg_newton.errors import run_command

def no_room(**options):
    raise PermissionError(13, "Permission denied", "/tmp")

def work():
    if {broken}:
        tempfile.mkdtemp = no_room
    import aicpg_newton.engines.warp_log
    import warp
    print(warp.config.kernel_cache_dir)

run_command(work)
"""


def start_warp(cache: Path, *, broken: bool = False) -> tuple[int, str, list[str]]:
    """Start Warp with a folder for its kernels: exit status, the folder that it takes, and lines on stderr."""
    environment = os.environ | {"WARP_CACHE_PATH": str(cache)}
    command = [sys.executable, "-c", WORK.format(broken=broken)]
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    lines = [line for line in result.stderr.splitlines() if not line.startswith("Warp ")]
    return result.returncode, result.stdout.strip(), lines


def test_a_folder_that_cannot_be_made_is_replaced(tmp_path: Path):
    """By a temporary one that is gone afterwards; one line says so and names the variable."""
    (tmp_path / "file").touch()
    status, folder, lines = start_warp(tmp_path / "file" / "cache")
    assert status == 0 and "aicpg_newton_kernels_" in folder and not Path(folder).exists()
    assert len(lines) == 1 and "set WARP_CACHE_PATH to a folder to keep them" in lines[0]


def test_nor_a_temporary_one(tmp_path: Path):
    """Then it is one sentence."""
    (tmp_path / "file").touch()
    status, _, lines = start_warp(tmp_path / "file" / "cache", broken=True)
    assert status == 2 and len(lines) == 1
    assert lines[0].startswith("error: there is no folder for compiled kernels (")
    assert "set WARP_CACHE_PATH or TMPDIR to a folder that can be written to" in lines[0]


def test_a_folder_that_can_be_written_to_is_taken(tmp_path: Path):
    """Without a word."""
    status, folder, lines = start_warp(tmp_path / "cache")
    assert (status, lines) == (0, []) and folder.startswith(str(tmp_path / "cache"))
