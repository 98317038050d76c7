"""Writing with torch, and reading what torch has written, which may come from anybody."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import torch

from aicpg_newton.errors import UserError


class Unreadable(UserError):
    """A file that is torn or something else."""


MOST_BYTES = 4_000_000_000
"""No checkpoint of this package comes near it; an AMP replay buffer of a million pairs has 0.7 GB."""

_MOST_ENTRIES = 100_000
_DEEPEST = 32


def write_tensors(content: Any, path: Path) -> None:
    """Write numbers, texts, containers and tensors, for :func:`read_tensors`.

    Raises:
        OSError: The disk does not take it; torch would tell of the position it lost instead.
    """
    with path.open("wb") as file:
        try:
            torch.save(content, file)
        except RuntimeError as error:
            if isinstance(error.__context__, OSError):
                raise error.__context__ from None
            raise


def read_tensors(path: Path, what: str, advice: str) -> Any:
    """Content of a file by ``torch.save``: numbers, texts, containers and tensors, never code.

    Args:
        path: The file.
        what: What it should be, for messages, as ``a checkpoint``.
        advice: What to do if it is not.

    Raises:
        UserError: The file cannot be read, holds anything else, or claims to hold more than is in it:
            :class:`Unreadable` where it may be cut short.
    """
    try:
        _check_archive(path)
        content = torch.load(path, map_location="cpu", weights_only=True)
        _check_content(content, path.stat().st_size)
        return content
    except UserError:
        raise
    except MemoryError as error:
        raise UserError(f"{path} does not fit into memory; it is not {what} of this package") from error
    except Exception as error:  # torch raises many types on torn files
        raise Unreadable(f"{path} cannot be read as {what} and may be cut short; {advice}") from error


def _check_archive(path: Path) -> None:
    """Refuse archives that grow when they are read: torch stores its tensors as they are.

    Raises:
        ValueError: It does, or holds anything but files of its own size.
    """
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise UserError(f"{path} has {size / 1e9:.1f} GB, more than anything this package writes; give another file")
    with zipfile.ZipFile(path) as archive:  # older formats of torch are none
        entries = archive.infolist()
        if len(entries) > _MOST_ENTRIES or any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
            raise ValueError("the archive is packed")
        if sum(entry.file_size for entry in entries) > size:
            raise ValueError("the archive holds more than its own size")


def _check_content(content: Any, size: int) -> None:
    """Refuse content that is larger than it looks, as what is done with it then takes as long.

    Raises:
        ValueError: A tensor is larger than the file or no ordinary one, or containers go too deep or hold one another.
    """
    left = _MOST_ENTRIES
    stack = [(content, 0)]
    while stack:
        value, depth = stack.pop()
        left -= 1
        if left < 0 or depth > _DEEPEST:
            raise ValueError("too many entries, or too deep")
        if isinstance(value, torch.Tensor):
            ordinary = value.layout == torch.strided and value.device.type == "cpu" and not value.is_quantized
            if not ordinary or value.numel() * value.element_size() > size:
                raise ValueError("a tensor that is larger than the file")
        elif isinstance(value, dict):
            stack += [(each, depth + 1) for pair in value.items() for each in pair]
        elif isinstance(value, (list, tuple, set, frozenset)):
            stack += [(each, depth + 1) for each in value]
        elif value is not None and not isinstance(value, (bool, int, float, str, bytes)):
            raise ValueError(f"an object of type {type(value).__name__}")
