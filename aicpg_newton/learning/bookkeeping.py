"""What a run writes down about itself: its folder, its code. None of it may stop a training."""

from __future__ import annotations

import datetime
import subprocess
from pathlib import Path

from aicpg_newton import __version__, places
from aicpg_newton.errors import UserError

_HERE = Path(__file__).resolve().parent
_CLAIM = ".claimed"

CONFIG_NAME = "config.yaml"
"""File in a run folder with every setting as it was used."""

RUNNING = ".running"
"""File in a run folder that the process that trains there has locked, from its beginning to its end."""


def claim(folder: Path) -> None:
    """Take a folder for one run, before anything slow: of two that want it at once, one gets it.

    Args:
        folder: It may exist if nothing is in it.

    Raises:
        UserError: Another run has it, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / _CLAIM).open("x").close()
        others = [path.name for path in folder.iterdir() if path.name != _CLAIM]
    except FileExistsError as error:
        raise UserError(f"{folder} has just been taken by another run; choose another folder") from error
    except OSError as error:
        raise UserError(f"cannot write into {folder} ({error.strerror}); give --run-dir another one") from error
    if others:
        (folder / _CLAIM).unlink()
        raise UserError(f"--run-dir {folder} is not empty; choose another folder, or continue it with --resume")


def release(folder: Path) -> None:
    """The claim has done its work: the folder holds a run, or is removed if nothing came of it."""
    (folder / _CLAIM).unlink(missing_ok=True)
    if folder.is_dir() and all(path.name == RUNNING for path in folder.iterdir()):
        (folder / RUNNING).unlink(missing_ok=True)
        folder.rmdir()


def new_folder(parent: Path) -> Path:
    """Claim a folder named after date and time, with a number behind it where that is taken."""
    name = datetime.datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    for number in range(1, 1000):
        folder = parent / (name if number == 1 else f"{name}_{number}")
        if folder.exists():
            continue
        try:
            claim(folder)
        except UserError:
            if folder.exists():
                continue  # somebody was faster
            raise
        return folder
    raise UserError(f"{parent} holds a thousand runs of this second; give --run-dir another folder")


def git_revision() -> tuple[str, str]:
    """Commit of this checkout, with ``+`` where files differ from it, and why it is not known, where it is not.

    An installed wheel has a version in its place, though a repository of something else may lie around it.
    """
    if places.INSTALLED:
        return f"version {__version__}", ""
    commit, reason = _git("rev-parse", "HEAD")
    if reason:
        return "unknown", reason
    changed, _ = _git("status", "--porcelain", "--untracked-files=no")
    return commit.decode().strip() + ("+" if changed.strip() else ""), ""


def store_changes(folder: Path) -> None:
    """Write the uncommitted changes of the code into the folder's ``git/changes.diff``, in whatever encoding."""
    changes, reason = (b"", "") if places.INSTALLED else _git("diff", "HEAD")
    if reason or not changes:
        return
    try:
        (folder / "git").mkdir(exist_ok=True)
        (folder / "git" / "changes.diff").write_bytes(changes)
    except OSError as error:
        print(f"The uncommitted changes of the code could not be kept ({error.strerror}).")


def _git(*arguments: str) -> tuple[bytes, str]:
    """What git says of this checkout, or in one line why it says nothing."""
    try:
        done = subprocess.run(["git", *arguments], cwd=_HERE, capture_output=True, check=False, timeout=30)
    except FileNotFoundError:
        return b"", "git is not installed"
    except (OSError, subprocess.TimeoutExpired) as error:
        return b"", f"git does not answer ({type(error).__name__})"
    if done.returncode:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        return b"", lines[0].removeprefix("fatal: ") if lines else f"git ended with {done.returncode}"
    return done.stdout, ""
