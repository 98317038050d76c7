"""A generator of malformed inputs: truncated, reordered, of the wrong type, huge, in other encodings, hostile."""

from __future__ import annotations

import codecs
import copy
import random
from collections.abc import Iterator
from typing import Any

import torch

SEED = 16


def of_text(text: str) -> Iterator[tuple[str, bytes]]:
    """What can become of a text file, with a name for each; a few may still be read."""
    data, lines, random_ = text.encode(), text.splitlines(), random.Random(SEED)
    yield "empty", b""
    for share in (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99):
        yield f"truncated at {share}", data[: int(share * len(data))]
    yield "reversed", "\n".join(lines[::-1]).encode()
    for number in range(3):
        shuffled = lines.copy()
        random_.shuffle(shuffled)
        yield f"shuffled {number}", "\n".join(shuffled).encode()
    yield "twice", data + data
    yield "one line", data.replace(b"\n", b" ")
    yield "every second line", "\n".join(lines[::2]).encode()
    for encoding in ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-7", "cp037"):
        yield encoding, text.encode(encoding)
    yield "two marks", 2 * codecs.BOM_UTF8 + data
    yield "trailing NULs", data + bytes(4096)
    yield "NULs", bytes(10_000)
    yield "noise", random_.randbytes(20_000)
    yield "a long line", b"9" * 2_000_000
    yield "a long word", data.replace(b"0", b"0" * 5000, 1)
    digits = [place for place, letter in enumerate(text) if letter.isdigit()]
    for word in ("nan", "inf", "-inf", "1_0", "0x1p3", "1e999", "-1e308", "", "NULL", "٣", "²", "1,5", "--", "[", '"'):
        place = random_.choice(digits)
        yield f"{word!r} for a digit", (text[:place] + word + text[place + 1 :]).encode()
    for _ in range(12):
        place = random_.randrange(len(data))
        yield f"byte {place} turned", data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :]


def of_binary(data: bytes) -> Iterator[tuple[str, bytes]]:
    """What can become of a binary file; turned bytes may still be read."""
    random_ = random.Random(SEED)
    yield "empty", b""
    for share in (0.001, 0.1, 0.5, 0.9, 0.999):
        yield f"truncated at {share}", data[: int(share * len(data))]
    yield "without its head", data[64:]
    yield "reversed", data[::-1]
    yield "halves swapped", data[len(data) // 2 :] + data[: len(data) // 2]
    yield "text", b"model: yes\n" * 100
    yield "NULs", bytes(len(data))
    yield "noise", random_.randbytes(20_000)
    for _ in range(30):
        place = random_.randrange(len(data))
        yield (
            f"byte {place} turned",
            data[:place] + bytes([data[place] ^ (1 << random_.randrange(8))]) + data[place + 1 :],
        )


WRONG: tuple[Any, ...] = (
    None, "text", "", -1, 10**30, float("nan"), float("-inf"), True, [], [1, "a"], {}, {"a": 1}, b"x", torch.zeros(3),
)  # fmt: skip
"""Values of which a few at most are right anywhere."""


def of_content(content: dict[str, Any], depth: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Nested content with one entry missing or wrong, and with one too many, down to a depth."""
    random_ = random.Random(SEED)
    for path in _paths(content, depth):
        name = ".".join(map(str, path))
        yield f"without {name}", _changed(content, path, None, remove=True)
        for wrong in random_.sample(WRONG, 3):
            yield f"{name} = {wrong!r}", _changed(content, path, wrong)
        yield f"a neighbour of {name}", _changed(content, (*path[:-1], "surprise"), 1)


def _paths(content: dict[str, Any], depth: int) -> Iterator[tuple]:
    """Keys of nested dictionaries."""
    for key, value in content.items():
        yield (key,)
        if isinstance(value, dict) and depth > 1:
            yield from ((key, *rest) for rest in _paths(value, depth - 1))


def _changed(content: dict[str, Any], path: tuple, value: Any, remove: bool = False) -> dict[str, Any]:
    """A copy with one entry changed."""
    result = copy.copy(content)
    owner = result
    for key in path[:-1]:
        owner[key] = copy.copy(owner[key])
        owner = owner[key]
    if remove:
        del owner[path[-1]]
    else:
        owner[path[-1]] = value
    return result
