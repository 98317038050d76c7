"""Texts and numbers that somebody else wrote."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from aicpg_newton.errors import UserError

_MOST_BYTES = 200_000_000
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")
_WIDE = {codecs.BOM_UTF32_LE: "UTF-32", codecs.BOM_UTF32_BE: "UTF-32"} | dict.fromkeys(
    (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE), "UTF-16"
)
"""Marks at the beginning of a file, the longer ones first."""


def read_text(path: Path) -> str:
    """A text file in UTF-8, with a byte order mark or without; letters of other encodings become question marks.

    Raises:
        UserError: It is missing, far too large, or no such text; the message says what it is.
    """
    if not path.is_file():  # a pipe would be waited for
        raise UserError(f"there is no file {path}; give an existing text file")
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise UserError(f"{path} is larger than {_MOST_BYTES // 1_000_000} MB; give a smaller file")
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"cannot read {path} ({error.strerror}); give an existing text file") from error
    for mark, name in _WIDE.items():
        if data.startswith(mark):
            raise UserError(f"{path} is in {name}; save it as UTF-8 or ASCII")
    if data.count(b"\0") > 0.2 * len(data):
        raise UserError(f"{path} is in UTF-16 or no text at all; save it as UTF-8 or ASCII")
    if b"\0" in data:
        raise UserError(f"{path} holds NUL bytes, as a copy that was broken off; fetch it again")
    return data.decode("utf-8-sig", errors="replace")


def number(word: str) -> float:
    """A decimal number, as people write it: no ``nan``, no ``1_000``, no digits of other scripts.

    Raises:
        ValueError: It is none, or too large for a float.
    """
    if not _NUMBER.fullmatch(word):
        raise ValueError(f"{word[:40]!r} is no number")
    value = float(word)
    if value in (float("inf"), float("-inf")):
        raise ValueError(f"{word[:40]!r} is too large")
    return value
