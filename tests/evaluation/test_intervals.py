"""95 % intervals against tables, and that they hold what they promise."""

import math

import pytest
import torch

from aicpg_newton.evaluation import intervals


@pytest.mark.parametrize(
    ("degrees", "quantile"), [(1, 12.706), (2, 4.303), (4, 2.776), (5, 2.571), (10, 2.228), (31, 2.040), (1000, 1.962)]
)
def test_student(degrees: int, quantile: float):
    """Against printed tables."""
    assert intervals.student(degrees) == pytest.approx(quantile, rel=0.011)


def test_half_width_by_hand():
    """1, 2, 3: variance 1, so 4.303 / sqrt(3); what is missing does not count."""
    assert intervals.half_width([1.0, math.nan, 2.0, 3.0]) == pytest.approx(4.3027 / math.sqrt(3))
    assert math.isnan(intervals.half_width([1.0, math.nan]))
    assert intervals.half_width([5.0] * 40) == 0.0


def test_nineteen_of_twenty_intervals_hold_the_mean():
    """Of 4,000 samples of 32 numbers."""
    samples = torch.randn(4000, 32, generator=torch.Generator().manual_seed(0)) + 7.0
    halves = torch.tensor([intervals.half_width(sample.tolist()) for sample in samples])
    inside = ((samples.mean(dim=1) - 7.0).abs() < halves).float().mean()
    assert 0.94 < inside < 0.96


def test_shares():
    """Wilson's interval by his formula; all and none stay within 0 and 1."""
    assert intervals.of_share(4, 4) == (pytest.approx(0.5101, abs=1e-4), 1.0)
    assert intervals.of_share(32, 32)[0] == pytest.approx(0.8928, abs=1e-4)
    low, high = intervals.of_share(8, 10)
    assert (low, high) == (pytest.approx(0.4902, abs=1e-4), pytest.approx(0.9433, abs=1e-4))
    assert intervals.of_share(0, 32) == (pytest.approx(0.0), pytest.approx(1 - intervals.of_share(32, 32)[0]))
    with pytest.raises(ValueError, match="5 of 4 is no share"):
        intervals.of_share(5, 4)


def test_what_never_happened_may_yet():
    """No fall of 32 robots in a minute each: fewer than 0.094 a minute, with 95 %."""
    assert intervals.half_width_of_rate([0.0] * 32, 1.0) == pytest.approx(2.9957 / 32, rel=1e-4)
    assert intervals.half_width_of_rate([1.0, 2.0, 3.0], 0.5) == pytest.approx(2 * 4.3027 / math.sqrt(3))
