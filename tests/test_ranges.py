"""Ranges beside help texts, and the one place where they are checked."""

import math
from dataclasses import dataclass, field
from typing import Annotated

import pytest

from aicpg_newton.errors import UserError
from aicpg_newton.ranges import ANY, NOT_NEGATIVE, POSITIVE, SHARE, Range, check_ranges


@dataclass
class Inner:
    """Settings within settings."""

    share: Annotated[float, SHARE] = 0.5


@dataclass
class Outer:
    """Settings."""

    some_number: Annotated[float | None, POSITIVE] = None
    sizes: Annotated[tuple[int, ...], Range(1, 100_000)] = (1, 2)
    free: float = math.nan
    inner: Inner = field(default_factory=Inner)


def test_both_ends_are_in_and_what_is_no_number_is_out():
    """Zero as well, where a number has to be positive."""
    assert 0.0 in SHARE and 1.0 in SHARE and -0.0 in SHARE and 1.0000001 not in SHARE
    assert 0.0 not in POSITIVE and 5e-324 in POSITIVE
    assert 0 in NOT_NEGATIVE and -1 not in NOT_NEGATIVE
    for allowed in (SHARE, POSITIVE, NOT_NEGATIVE, ANY):
        assert math.nan not in allowed and math.inf not in allowed and -math.inf not in allowed


def test_messages_say_what_may_be():
    """Names of settings are dotted, those of options have dashes."""
    check_ranges(Outer())
    with pytest.raises(UserError, match=r"^inner.share is 2; give a number from 0 to 1$"):
        check_ranges(Outer(inner=Inner(share=2)))
    with pytest.raises(UserError, match=r"^--some-number is -1.0; give a positive number$"):
        check_ranges(Outer(some_number=-1.0), "--")
    with pytest.raises(UserError, match=r"^task.sizes is 100001; give a number from 1 to 100_000$"):
        check_ranges(Outer(sizes=(1, 100_001)), "task.")
