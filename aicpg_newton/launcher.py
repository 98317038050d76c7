"""What a launcher as torchrun has told this process about itself and those beside it."""

from __future__ import annotations

import os
from dataclasses import dataclass

_NEEDED = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT")


@dataclass(frozen=True)
class Place:
    """Place of a process among those that were started together."""

    rank: int = 0
    """Number of this process, from 0."""
    size: int = 1
    """Number of processes on all machines."""
    local_rank: int = 0
    """Number of this process on its machine; its GPU is the one of that number."""
    local_size: int = 1
    """Number of processes on this machine, which share its cores."""


def place() -> Place:
    """The place of this process; alone where the launcher's variables are not all there.

    Raises:
        ValueError: They are there, but are no numbers that fit together; the message says which.
    """
    if any(name not in os.environ for name in _NEEDED):
        return Place()
    names = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE")
    given = [os.environ.get(name, "1") for name in names]
    if not all(value.isdigit() for value in given):
        raise ValueError(_told(names) + ", where whole numbers are needed")
    found = Place(*map(int, given))
    if found.rank >= found.size or found.local_rank >= max(found.local_size, 1):
        raise ValueError(_told(names) + ", but ranks count from 0 and stay below the number of processes")
    return found


def incomplete() -> str:
    """Where several processes are spoken of, but not all is told that they need: what is wrong; else nothing."""
    told = os.environ.get("WORLD_SIZE", "")
    missing = [name for name in _NEEDED if name not in os.environ]
    if told in ("", "1") or not missing:
        return ""
    named = " and ".join((", ".join(missing[:-1]), missing[-1])) if missing[1:] else missing[0]
    return f"WORLD_SIZE is {told}, but {named} {'are' if missing[1:] else 'is'} not set"


def _told(names: tuple[str, ...]) -> str:
    return ", ".join(f"{name}={os.environ[name]}" for name in names if name in os.environ)
