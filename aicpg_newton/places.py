"""Where what belongs to this package lies: beside it in a checkout, within it where its wheel is installed."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent

INSTALLED = (_PACKAGE / "assets").is_dir()
"""Whether this is a wheel's copy, away from the checkout."""

_HOME = _PACKAGE if INSTALLED else _PACKAGE.parent

ASSETS = _HOME / "assets"
"""The humanoid, the pattern network and the trained networks."""

TASKS = _HOME / "tasks"
"""The tasks that come with the package."""


def command(door: str) -> str:
    """How a user calls ``train``, ``play`` or ``evaluate`` here."""
    if INSTALLED:
        return f"aicpg-{door}"
    return "python -m aicpg_newton.evaluate" if door == "evaluate" else f"python {door}.py"


def portable(path: Path) -> str:
    """Name of a file or a folder that means something on other machines too: within the checkout, or its own."""
    try:
        return path.resolve().relative_to(_HOME).as_posix()
    except ValueError:
        return path.resolve().name
