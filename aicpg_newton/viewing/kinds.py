"""The kinds of viewers, and what each needs on this machine; told without loading one."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec

VIEWER_KINDS = ("viser", "gl", "usd", "none")
"""viser: in a browser; gl: a window; usd: a file to open elsewhere; none: nothing."""

LIVE_KINDS = ("viser", "gl")
"""Those that somebody watches while the simulation runs."""

_PACKAGES = {
    "viser": {"viser": "viser"},
    "gl": {"pyglet": "pyglet", "imgui_bundle": "imgui-bundle"},
    "usd": {"pxr": "usd-core"},
    "none": {},
}
"""Modules that each kind imports, and what pip calls their packages."""


def missing_packages(kind: str) -> list[str]:
    """What pip has to install before a viewer of this kind can be opened."""
    return [package for module, package in _PACKAGES[kind].items() if find_spec(module) is None]


def has_screen() -> bool:
    """Whether somebody sits in front of this machine, so that a browser can be opened."""
    return sys.platform in ("darwin", "win32") or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
