"""What an export needs beside the package; told without loading anything of it."""

from __future__ import annotations

import shutil
from importlib.util import find_spec

from aicpg_newton.errors import UserError
from aicpg_newton.places import ASSETS

SOURCE = ASSETS.parent / "web"
"""Source of the page, in a checkout."""

_EXTRA = ("onnx", "onnxscript")
"""Packages that write the file; they come with the extra ``export``."""


def check_packages() -> None:
    """Look for what the export needs beside the package.

    Raises:
        UserError: It is not installed.
    """
    missing = [name for name in _EXTRA if find_spec(name) is None]
    if missing:
        raise UserError(f'the export needs {" and ".join(missing)}; run: pip install -e ".[export]"')


def check_source() -> None:
    """Look for what the build needs.

    Raises:
        UserError: It is not there.
    """
    if not SOURCE.is_dir():
        raise UserError("the page's source is not part of the installed package; give --web in a checkout of it")
    if shutil.which("node") is None or shutil.which("npm") is None:
        raise UserError("the page is built with Node.js and npm, which are not here; install Node.js 20 or later")
