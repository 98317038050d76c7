"""Whether AI-CPG is better than the others, as far as seeds can tell.

On a plane at the same speed (paper, Sec. III-B), on uneven ground in the same gait (Sec. III-D).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from aicpg_newton.env.methods import METHODS
from aicpg_newton.evaluation.intervals import student
from aicpg_newton.evaluation.results import Row
from aicpg_newton.evaluation.summaries import stays_on_course

OURS = METHODS["ai-cpg"].title
"""The method that the others are compared with; its speed follows the stride frequency."""

QUANTITIES = {
    "cost_of_transport": "cost of transport",
    "symmetry_index": "symmetry index",
    "falls_per_minute": "falls a minute, pushed",
}
"""Columns that are compared on a plane: of all of them less is better."""

ON_TERRAIN = {
    "survived": "share that never fell",
    "symmetry_index": "symmetry index",
    "balance_index": "balance index",
    "cost_of_transport": "cost of transport",
}
"""Columns that are compared on uneven ground: more is better of the first and the third."""


@dataclass(frozen=True)
class Comparison:
    """One quantity of another controller beside AI-CPG's at the same speed or in the same gait."""

    quantity: str
    """A column of :data:`QUANTITIES` or :data:`ON_TERRAIN`."""
    other: str
    """Method and condition, as ``PPO 2.5``."""
    speed: float
    """Mean speed of the other's seeds that have one, at which AI-CPG is looked up on a plane [m/s]."""
    ours: tuple[float, ...]
    """AI-CPG's value there, of each seed that has one: on a plane, that reaches the speed."""
    theirs: tuple[float, ...]
    """The other's value, of each seed that has one."""
    seeds: tuple[int, int]
    """How many seeds of AI-CPG and of the other there are, with those that have no value."""
    reached: bool = True
    """Whether any seed of AI-CPG goes at this speed; on uneven ground it need not."""

    @property
    def difference(self) -> tuple[float, float]:
        """AI-CPG's mean less the other's, and half its 95 % interval: NaN where either has fewer than two seeds.

        Welch's interval (B. L. Welch, Biometrika 34, 1947), as seeds of the two methods differ by different amounts.
        """
        if not self.ours or not self.theirs:
            return math.nan, math.nan
        difference = float(np.mean(self.ours) - np.mean(self.theirs))
        groups = (self.ours, self.theirs)
        if min(map(len, groups)) < 2:
            return difference, math.nan
        squares = [float(np.var(each, ddof=1)) / len(each) for each in groups]
        if sum(squares) == 0.0:
            return difference, 0.0
        degrees = sum(squares) ** 2 / sum(s**2 / (len(each) - 1) for s, each in zip(squares, groups, strict=True))
        return difference, student(max(1, math.floor(degrees))) * math.sqrt(sum(squares))

    @property
    def verdict(self) -> str:
        """What the seeds say, in words."""
        difference, half = self.difference
        if not self.theirs:
            return f"{self.other} has no value"
        if not self.ours:
            return "AI-CPG has no value" if self.reached else "AI-CPG does not go at this speed"
        if math.isnan(half):
            return "too few seeds"
        if abs(difference) <= half:
            return "not told apart"
        return "AI-CPG less" if difference < 0.0 else "AI-CPG more"


def at_speed(rows: Iterable[Row], speed: float, column: str) -> float:
    """Value of one AI-CPG controller at a speed, on straight lines between its stride frequencies.

    Args:
        rows: Its rows at all frequencies. Those in which over half of the robots fell or turned away within the trial
            say nothing.
        speed: [m/s].
        column: What is asked for.

    Returns:
        NaN outside of the speeds that it goes at.
    """
    points = [(row["speed_mps"], row[column]) for row in rows if stays_on_course(row)]
    pairs = sorted(point for point in points if all(map(math.isfinite, point)))
    if not pairs or not pairs[0][0] <= speed <= pairs[-1][0]:
        return math.nan
    speeds, values = zip(*pairs, strict=True)
    return float(np.interp(speed, speeds, values))


def compare(sweep: Sequence[Row], disturbance: Sequence[Row]) -> list[Comparison]:
    """All comparisons that two tables allow, by quantity and then by speed.

    Args:
        sweep: Rows of the sweep protocol, of any seeds.
        disturbance: Rows of the disturbance protocol, or none.
    """
    found = []
    for quantity in QUANTITIES:
        rows = disturbance if quantity == "falls_per_minute" else sweep
        mine = _by_seed(row for row in rows if row["method"] == OURS)
        others = dict.fromkeys((row["method"], row["condition"]) for row in rows if row["condition"])
        group = []
        for method, condition in others:
            theirs = _by_seed(row for row in rows if (row["method"], row["condition"]) == (method, condition))
            speeds = [row["speed_mps"] for each in theirs.values() for row in each]
            speed = float(np.mean([each for each in speeds if math.isfinite(each)] or math.nan))
            ours = [at_speed(each, speed, quantity) for each in mine.values()]
            group.append(
                Comparison(
                    quantity=quantity,
                    other=f"{method} {condition}",
                    speed=speed,
                    ours=tuple(value for value in ours if math.isfinite(value)),
                    theirs=_of_seeds(theirs, quantity),
                    seeds=(len(mine), len(theirs)),
                    reached=not mine
                    or any(math.isfinite(at_speed(each, speed, "speed_mps")) for each in mine.values()),
                )
            )
        found += sorted(group, key=lambda each: _place(each.speed))
    return found


def compare_on_terrain(terrain: Sequence[Row]) -> list[Comparison]:
    """All comparisons that a table of uneven ground allows, by quantity, gait and speed; a seed's mean over terrains.

    AI-CPG's robots at the frequency of a gait stand beside the networks that were trained for the same gait, at
    whatever speed either goes.

    Args:
        terrain: Rows of the terrain protocol, of any seeds.
    """
    others = []
    for other in dict.fromkeys((row["gait"], row["method"], row["condition"]) for row in terrain if row["condition"]):
        gait, method, condition = other
        mine = _by_seed(row for row in terrain if (row["method"], row["gait"]) == (OURS, gait))
        theirs = _by_seed(row for row in terrain if (row["gait"], row["method"], row["condition"]) == other)
        speed = float(np.mean(_of_seeds(theirs, "speed_mps") or math.nan))
        others.append((gait != "walking", _place(speed), f"{method} {condition}", speed, mine, theirs))
    others.sort(key=lambda each: each[:2])
    return [
        Comparison(
            quantity, name, speed, _of_seeds(mine, quantity), _of_seeds(theirs, quantity), (len(mine), len(theirs))
        )
        for quantity in ON_TERRAIN
        for _, _, name, speed, mine, theirs in others
    ]


def _place(speed: float) -> float:
    """Where a speed stands in an order; one that is not known at the end."""
    return speed if math.isfinite(speed) else math.inf


def _of_seeds(seeds: dict[float, list[Row]], column: str) -> tuple[float, ...]:
    """Each seed's mean, of the seeds that have a value."""
    values = ([row[column] for row in each if math.isfinite(row[column])] for each in seeds.values())
    return tuple(float(np.mean(each)) for each in values if each)


def _by_seed(rows: Iterable[Row]) -> dict[float, list[Row]]:
    """Rows of each seed."""
    seeds: dict[float, list[Row]] = {}
    for row in rows:
        seeds.setdefault(row["seed"], []).append(row)
    return seeds


def by_chance(comparisons: Iterable[Comparison]) -> str:
    """A sentence on how many are told apart, and how many would be if nothing differed: one interval in 20 misses."""
    differences = [each.difference for each in comparisons]
    apart = [abs(difference) > half for difference, half in differences if not math.isnan(half)]
    return (
        f"{sum(apart)} of {len(apart)} with an interval are told apart; {0.05 * len(apart):.1f} would be by chance if"
        " nothing differed."
    )


def table(comparisons: Iterable[Comparison]) -> str:
    """The comparisons as a Markdown table: each seed's value, the difference of the means, and what it says.

    Where seeds have no value, as their robots fell at once or do not go at this speed, it says how many.
    """
    titles = QUANTITIES | ON_TERRAIN
    head = ("", "at [m/s]", "beside", "AI-CPG, each seed", "the other, each seed", "difference", "")
    lines = [head, ("---",) * len(head)]
    for each in comparisons:
        difference, half = each.difference
        told = "-" if math.isnan(difference) else f"{difference:+.2f}"
        told += "" if math.isnan(half) else f" ± {half:.2f}"
        values = map(_told, (each.ours, each.theirs), each.seeds)
        speed = f"{each.speed:.2f}" if math.isfinite(each.speed) else "-"
        lines.append((titles[each.quantity], speed, each.other, *values, told, each.verdict))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _told(values: Sequence[float], seeds: int) -> str:
    """The values of seeds, and how many have none."""
    told = ", ".join(f"{value:.2f}" for value in values) or "-"
    none = seeds - len(values)
    return f"{told} ({none} of {seeds} seed{'s' if seeds != 1 else ''} without a value)" if none else told
