"""How certain a measured number is: 95 % intervals from as many robots or seeds as there were."""

from __future__ import annotations

import math
from collections.abc import Sequence

_NORMAL = 1.959964
"""Quantile 0.975 of the normal distribution."""

_STUDENT = (12.7062, 4.3027, 3.1824, 2.7764)
"""Quantile 0.975 of Student's t distribution with 1 to 4 degrees of freedom."""

_NEVER_SEEN = -math.log(0.05)
"""Of what happened not once, the number that would have been seen with a probability of 95 %: the rule of three."""


def student(degrees: int) -> float:
    """Quantile 0.975 of Student's t distribution with so many degrees of freedom, at least 1.

    From 5 on its expansion about the normal distribution (R. A. Fisher and E. A. Cornish 1960), right to 1 %.
    """
    if degrees <= len(_STUDENT):
        return _STUDENT[degrees - 1]
    z = _NORMAL
    return z + (z**3 + z) / (4 * degrees) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * degrees**2)


def half_width(values: Sequence[float]) -> float:
    """Half the 95 % interval of a mean (Student); NaN of fewer than two values. What is not finite does not count."""
    finite = [value for value in values if math.isfinite(value)]
    number = len(finite)
    if number < 2:
        return math.nan
    mean = math.fsum(finite) / number
    variance = math.fsum((value - mean) ** 2 for value in finite) / (number - 1)
    return student(number - 1) * math.sqrt(variance / number)


def half_width_of_rate(counts: Sequence[float], times: float) -> float:
    """The same of how often something happens in a unit of time; where it never did, of how often it yet may.

    Args:
        counts: How often it happened in each of several observations.
        times: How many units of time each of them lasted.
    """
    if not any(counts):
        return _NEVER_SEEN / (len(counts) * times) if counts else math.nan
    return half_width([count / times for count in counts])


def of_share(successes: int, number: int) -> tuple[float, float]:
    """95 % interval of a share (E. B. Wilson 1927), which stays within 0 and 1: of 4 of 4 it begins at 0.51."""
    if not 0 <= successes <= number or number == 0:
        raise ValueError(f"{successes} of {number} is no share")
    share, spread = successes / number, _NORMAL**2 / number
    middle = (share + spread / 2) / (1 + spread)
    reach = _NORMAL * math.sqrt(share * (1 - share) / number + spread / (4 * number)) / (1 + spread)
    return (middle - reach if successes else 0.0), (middle + reach if successes < number else 1.0)
