"""Reading MJCF, which may come from anybody."""

# MuJoCo's extension module has no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco

from aicpg_newton.errors import UserError

_MOST_BYTES = 4_000_000
_FOLDERS = ("meshdir", "texturedir", "assetdir", "dir")


def checked(path: Path) -> mujoco.MjSpec:
    """The specification that an MJCF file holds, once it is sure that reading it reads nothing else.

    Raises:
        UserError: The file is missing, too large or broken, includes another file, loads a plugin, or names a file
            outside of its own folder.
    """
    if not path.is_file():
        raise UserError(f"there is no file {path}; give the path of an MJCF file")
    if path.stat().st_size > _MOST_BYTES:
        raise UserError(f"{path} is larger than {_MOST_BYTES // 1_000_000} MB, which no humanoid is; give an MJCF file")
    content = path.read_bytes()
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise UserError(f"{path} declares XML entities, which can stand for anything; write it without")
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise UserError(f"{path} is not well-formed XML ({error}); give an MJCF file") from error
    if root.tag != "mujoco":
        raise UserError(f"{path} is not MJCF: it begins with <{root.tag[:40]}>; give an MJCF file")
    for element in root.iter():
        if element.tag in ("include", "plugin", "extension"):
            raise UserError(f"{path} has an <{element.tag}>, which brings in other files; write it in one file without")
        for name, value in element.attrib.items():
            if (name.startswith("file") or name in _FOLDERS) and _leaves(value):
                raise UserError(
                    f"{path} names {value!r}, outside of its own folder; put the file beside it and give its name alone"
                )
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise UserError(f"{path} is not MJCF: {str(error).splitlines()[0]}; mend it") from error


def _leaves(name: str) -> bool:
    """Whether a path is absolute, on any system, or goes up."""
    absolute = name.startswith(("/", "\\", "~")) or re.match("[A-Za-z]:", name) is not None
    return absolute or ".." in re.split(r"[/\\]", name)
