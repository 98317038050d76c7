"""What all files that show something have in common."""

from __future__ import annotations

import os
from pathlib import Path

from aicpg_newton.errors import UserError

TEXT_COLOUR = (50, 54, 60)
"""8-bit sRGB of text in pictures."""


def writable_path(path: Path | str, suffix: str) -> Path:
    """Check a path before any work is done for it.

    Args:
        path: File that will be written.
        suffix: Ending that it must have, with the dot.

    Returns:
        The path.

    Raises:
        UserError: The ending is another, the folder is missing or not writable, or the path is a folder.
    """
    path = Path(path)
    if path.suffix.lower() != suffix:
        raise UserError(f"cannot write {path}: the file name must end in {suffix}")
    if not path.parent.is_dir():
        raise UserError(f"cannot write {path}: there is no folder {path.parent}; create it first")
    if not os.access(path.parent, os.W_OK):
        raise UserError(f"cannot write {path}: the folder {path.parent} may not be written to; choose another")
    if path.is_dir():
        raise UserError(f"cannot write {path}: it is a folder; give a file name")
    return path
