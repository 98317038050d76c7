"""Ranges of numbers: stated in a setting's annotation, beside its help text, and checked in one place."""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from aicpg_newton.errors import UserError


@dataclass(frozen=True)
class Range:
    """What a number may be, both ends included: ``Annotated[float, Range(0.0, 1.0)]``; of a tuple each element."""

    least: float = -math.inf
    most: float = math.inf
    positive: bool = False
    """Zero is out as well."""

    def __contains__(self, value: float) -> bool:
        inside = self.least <= value <= self.most and value not in (-math.inf, math.inf)  # integers may be any size
        return inside and not (self.positive and value <= 0)

    def __str__(self) -> str:
        most = f"{self.most:,.12g}".replace(",", "_") if abs(self.most) >= 1e5 else f"{self.most:g}"
        if self.positive:
            return "a positive number" if self.most == math.inf else f"a positive number of at most {most}"
        if self.most < math.inf:
            return f"a number from {self.least:g} to {most}"
        return "a finite number" if self.least == -math.inf else f"a finite number of at least {self.least:g}"


ANY = Range()
"""Any finite number."""

POSITIVE = Range(0.0, positive=True)
NOT_NEGATIVE = Range(0.0)
SHARE = Range(0.0, 1.0)
AT_LEAST_ONE = Range(1, 2**31 - 1)
ENVIRONMENTS = Range(1, 1_000_000)
"""Robots that are simulated at once."""

SEED = Range(0, 2**32 - 1)
"""What NumPy and torch both take."""


def check_ranges(settings: Any, prefix: str = "") -> None:
    """Refuse numbers out of their range, in a dataclass and in those within it.

    Args:
        settings: The dataclass; None in place of a number is not looked at.
        prefix: What stands before a setting's name in a message: dotted names, or ``--`` for an option.

    Raises:
        UserError: A number is; the message names it and says what it may be.
    """
    for name, value, allowed in _numbers(settings, prefix):
        if value not in allowed:
            raise UserError(f"{name} is {value}; give {allowed}")


def _numbers(settings: Any, prefix: str) -> Iterator[tuple[str, Any, Range]]:
    """Names, values and ranges."""
    hints = typing.get_type_hints(type(settings), include_extras=True)
    for each in dataclasses.fields(settings):
        value: Any = getattr(settings, each.name)
        name = prefix + (each.name.replace("_", "-") if prefix == "--" else each.name)
        if dataclasses.is_dataclass(value) and prefix != "--":
            yield from _numbers(value, f"{name}.")
        for allowed in getattr(hints[each.name], "__metadata__", ()):
            if isinstance(allowed, Range):
                values = value if isinstance(value, tuple) else (value,)
                yield from ((name, number, allowed) for number in values if number is not None)
