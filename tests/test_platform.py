"""macOS and Windows, as far as they can be tried elsewhere: what those systems do not have is taken away."""

import builtins
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from aicpg_newton.device import cpu_cores
from aicpg_newton.env.registry import get_task
from aicpg_newton.errors import UserError
from aicpg_newton.files import WholeFile, only_one, write_text
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.training import train
from aicpg_newton.learning.work import signals_that_interrupt
from aicpg_newton.playing.options import PlayOptions
from aicpg_newton.playing.play import play

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """No affinity, no SIGHUP, no fcntl or other modules of Unix, and folders that cannot be opened."""
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.delattr(os, "O_DIRECTORY", raising=False)
    monkeypatch.delattr(signal, "SIGHUP", raising=False)
    monkeypatch.delattr(signal, "SIGUSR1", raising=False)
    for name in ("fork", "killpg", "statvfs"):
        monkeypatch.delattr(os, name, raising=False)
    real_open, real_import, real_fsync = os.open, builtins.__import__, os.fsync

    def open_file(path: Any, *arguments: Any, **options: Any) -> int:
        if Path(path).is_dir() and sys._getframe(1).f_globals["__name__"].startswith("aicpg_newton"):
            raise PermissionError(13, "Permission denied", str(path))
        return real_open(path, *arguments, **options)

    def import_module(name: str, *arguments: Any, **options: Any) -> Any:
        if name in ("fcntl", "resource", "pwd", "grp", "termios"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real_import(name, *arguments, **options)

    def fsync(descriptor: int) -> None:
        # Windows waits only for what is open for writing.
        flags = Path(f"/proc/self/fdinfo/{descriptor}").read_text(encoding="utf-8").split("flags:")[1].split()[0]
        if int(flags, 8) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(9, "Bad file descriptor")
        real_fsync(descriptor)

    monkeypatch.setattr(os, "open", open_file)
    monkeypatch.setattr(builtins, "__import__", import_module)
    if Path("/proc/self/fdinfo").is_dir():
        monkeypatch.setattr(os, "fsync", fsync)


@pytest.mark.usefixtures("windows")
def test_files_are_kept_where_folders_cannot_be_opened(tmp_path: Path):
    """A whole file takes its name; one that fails leaves nothing."""
    path = tmp_path / "a.txt"
    write_text(path, "first")
    write_text(path, "second")
    assert path.read_text(encoding="utf-8") == "second"
    with pytest.raises(UserError, match="cannot write"), WholeFile(path) as temporary:
        temporary.write_text("half", encoding="utf-8")
        raise OSError(28, "No space left on device")
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]
    with only_one(tmp_path / "lock") as mine:
        assert mine


@pytest.mark.usefixtures("windows")
def test_cores_and_signals():
    """All cores, and those signals that are there."""
    assert cpu_cores() == (os.cpu_count() or 1)
    before = signal.getsignal(signal.SIGTERM)
    with signals_that_interrupt():
        assert signal.getsignal(signal.SIGTERM) is not before
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.usefixtures("windows")
def test_training_and_playing(tmp_path: Path):
    """From settings to a recording, on the mujoco engine."""
    task = get_task("flat")
    task.learning.hidden_sizes = (8, 8)
    task.learning.steps_per_iteration = 2
    last = train(
        task, RunOptions(num_envs=4, device="cpu", engine="mujoco", max_iterations=1, run_dir=tmp_path / "run")
    )
    tally = play(
        PlayOptions(
            checkpoint=last, device="cpu", num_envs=3, duration=0.5, frequency=(1.0,), record=tmp_path / "walk.mp4"
        ),
        get_task("flat"),
    )
    assert tally.steps == 30
    assert (tmp_path / "walk.mp4").stat().st_size > 1000
    assert torch.load(last, weights_only=True)["iteration"] == 1


def test_texts_have_line_feeds_and_say_their_encoding():
    """In the repository; ruff's rule on encodings is on, as Windows has another default."""
    attributes = subprocess.run(
        ["git", "check-attr", "eol", "binary", "--", "train.py", "assets/humanoid.xml", "assets/pattern_network.pt"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if attributes.returncode:
        pytest.skip("no git checkout")
    lines = attributes.stdout.splitlines()
    assert {"train.py: eol: lf", "assets/humanoid.xml: eol: lf", "assets/pattern_network.pt: binary: set"} <= set(lines)
    assert '"PLW1514"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
