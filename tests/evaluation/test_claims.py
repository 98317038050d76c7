"""AI-CPG beside others at the same speed, over seeds."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from aicpg_newton.claims import ClaimOptions, main
from aicpg_newton.errors import UserError
from aicpg_newton.evaluation import claims
from aicpg_newton.evaluation.results import Row


def row(method: str, condition: str, seed: int, speed: float, cost: float, survived: float = 1.0) -> Row:
    """A row of a sweep, with a symmetry index that is a tenth of the cost."""
    told = {"method": method, "condition": condition, "seed": seed, "speed_mps": speed, "survived": survived}
    return {**told, "cost_of_transport": cost, "symmetry_index": 0.1 * cost, "falls_per_minute": 10.0 * cost}


def ours(seed: int, shift: float = 0.0) -> list[Row]:
    """Cost rises by 0.1 a m/s from 1 to 3 m/s; at 0.5 m/s it falls."""
    standing = [row(claims.OURS, "", seed, speed, 0.1 * speed + shift) for speed in (3.0, 1.0, 2.0)]
    return [*standing, row(claims.OURS, "", seed, 0.5, 9.0, survived=0.4)]


def test_values_between_frequencies():
    """On straight lines, whatever the order of the rows; nothing beyond what it stands."""
    assert claims.at_speed(ours(0), 1.5, "cost_of_transport") == pytest.approx(0.15)
    assert claims.at_speed(ours(0), 3.0, "cost_of_transport") == pytest.approx(0.3)
    assert math.isnan(claims.at_speed(ours(0), 0.7, "cost_of_transport"))
    assert math.isnan(claims.at_speed(ours(0), 3.1, "cost_of_transport"))
    assert math.isnan(claims.at_speed([], 1.0, "cost_of_transport"))


def test_comparisons():
    """At the mean speed of the other's seeds, by quantity and speed."""
    rows = [each for seed in range(3) for each in ours(seed, 0.01 * seed)]
    rows += [row("PPO", "2.5", seed, 2.4 + 0.1 * seed, 1.0 + 0.01 * seed) for seed in range(3)]
    rows += [row("AMP", "walk", seed, 1.0 + 0.1 * seed, (0.05, 0.12, 0.2)[seed]) for seed in range(3)]
    rows += [row("PPO", "4.0", 0, 4.0, 1.0)]
    found = claims.compare(rows, rows)
    assert [each.other for each in found] == ["AMP walk", "PPO 2.5", "PPO 4.0"] * 3
    assert [each.quantity for each in found] == [name for name in claims.QUANTITIES for _ in range(3)]
    walk, run, fast = found[:3]
    assert run.speed == pytest.approx(2.5) and run.ours == pytest.approx((0.25, 0.26, 0.27))
    difference, half = run.difference
    assert difference == pytest.approx(-0.75)
    # Equal spread 0.01 and three seeds each: four degrees of freedom.
    assert half == pytest.approx(2.7764 * math.sqrt(2 * 0.01**2 / 3), rel=1e-3)
    assert [each.verdict for each in found[:3]] == ["not told apart", "AI-CPG less", "AI-CPG does not go at this speed"]
    assert walk.ours == pytest.approx((0.11, 0.12, 0.13)) and fast.ours == ()
    assert found[7].theirs == pytest.approx((10.0, 10.1, 10.2))
    assert (
        claims.by_chance(found) == "3 of 6 with an interval are told apart; 0.3 would be by chance if nothing differed."
    )
    assert claims.by_chance([]).startswith("0 of 0")
    assert claims.Comparison("cost_of_transport", "PPO 1", 1.0, (2.0, 2.1), (1.0, 1.1), (2, 2)).verdict == "AI-CPG more"
    assert claims.Comparison("cost_of_transport", "PPO 1", 1.0, (2.0,), (1.0, 1.1), (1, 2)).verdict == "too few seeds"


def test_a_seed_that_fell_is_counted():
    """Means are over the others, at their speed, and no verdict is made of what is not known."""
    fell = row("PPO", "2.5", 2, math.nan, math.nan, survived=0.0)
    rows = [each for seed in range(2) for each in ours(seed, 0.01 * seed)]
    rows += [row("PPO", "2.5", seed, 2.5, 1.0 + 0.01 * seed) for seed in range(2)] + [fell | {"falls_per_minute": 40.0}]
    rows += [row("PPO", "4.0", seed, math.nan, math.nan, survived=0.0) for seed in range(3)]
    rows += [row("AMP", "run", 0, 4.0, 1.0)]
    found = claims.compare(rows, rows)
    cost = {each.other: each for each in found[:3]}
    assert cost["PPO 2.5"].speed == pytest.approx(2.5) and cost["PPO 2.5"].theirs == pytest.approx((1.0, 1.01))
    assert cost["PPO 2.5"].seeds == (2, 3) and cost["PPO 2.5"].verdict == "AI-CPG less"
    assert cost["PPO 4.0"].theirs == () and cost["PPO 4.0"].verdict == "PPO 4.0 has no value"
    assert cost["AMP run"].verdict == "AI-CPG does not go at this speed"
    assert found[2] is cost["PPO 4.0"]  # whose speed is not known
    falls = {each.other: each for each in found[6:]}
    assert falls["PPO 2.5"].theirs == pytest.approx((10.0, 10.1, 40.0))
    unknown = [each | {"cost_of_transport": math.nan} if each["method"] == claims.OURS else each for each in rows]
    assert claims.compare(unknown, unknown)[0].verdict == "AI-CPG has no value"
    table = claims.table(found)
    assert "| 1.00, 1.01 (1 of 3 seeds without a value) |" in table and "nan" not in table
    assert "| - | PPO 4.0 | - (2 of 2 seeds without a value) | - (3 of 3 seeds without a value) |" in table


def test_values_need_a_speed():
    """Falls are counted also where no robot walked for a second."""
    rows = [*ours(0), row(claims.OURS, "", 0, math.nan, 9.0)]
    assert claims.at_speed(rows, 1.5, "falls_per_minute") == pytest.approx(1.5)


def test_comparisons_on_uneven_ground():
    """In the same gait, a seed's mean over terrains; what has no value is left out."""
    terrain: list[Row] = []
    for method, condition, gait, speed, costs in (
        (claims.OURS, "", "walking", 1.5, (0.8, 0.9)),
        (claims.OURS, "", "running", 3.0, (1.0, 1.2)),
        ("PPO", "1.5", "walking", 1.4, (0.5, 0.7)),
        ("PPO", "3.5", "running", 3.2, (2.0, math.nan)),
        ("AMP", "run", "running", 2.9, (1.0, 1.0)),
    ):
        for seed, cost in enumerate(costs):
            for terrain_seed, more in ((1001, -0.1), (1002, 0.1)):
                told = row(method, condition, seed, speed, cost + more, survived=0.9 + more)
                terrain.append({**told, "gait": gait, "terrain_seed": terrain_seed, "balance_index": 1.0 - 0.1 * cost})
    found = claims.compare_on_terrain(terrain)
    assert [each.other for each in found] == ["PPO 1.5", "AMP run", "PPO 3.5"] * 4  # by gait, then by speed
    assert [each.quantity for each in found] == [name for name in claims.ON_TERRAIN for _ in range(3)]
    walk, run, fast = found[9:]
    assert walk.ours == pytest.approx((0.8, 0.9)) and walk.theirs == pytest.approx((0.5, 0.7))
    assert run.ours == fast.ours == pytest.approx((1.0, 1.2)) and fast.theirs == pytest.approx((2.0,))
    assert walk.speed == pytest.approx(1.4) and fast.verdict == "too few seeds"
    assert found[0].ours == pytest.approx((0.9, 0.9)) and found[6].theirs == pytest.approx((0.95, 0.93))
    assert "| share that never fell | 1.40 | PPO 1.5 | 0.90, 0.90 |" in claims.table(found)
    assert claims.compare_on_terrain([]) == []


def test_the_interval_holds_as_often_as_it_says():
    """Of two groups of three with the same mean and unlike spreads: 95 % of intervals hold 0, or a few more."""
    random = np.random.default_rng(0)
    held = 0
    for _ in range(2000):
        one, other = (tuple(random.normal(1.0, spread, 3)) for spread in (0.1, 0.4))
        difference, half = claims.Comparison("cost_of_transport", "PPO 1", 1.0, one, other, (3, 3)).difference
        held += abs(difference) <= half
    assert 0.94 < held / 2000 < 0.99


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """From the tables in the repository; one sentence where there is nothing to compare."""
    docs = Path(__file__).resolve().parents[2] / "docs"
    found = main(ClaimOptions(results=(docs / "seeds",)))
    printed = capsys.readouterr().out
    assert len(printed.splitlines()) == 4 + len(found) and "| PPO 2.5 |" in printed
    assert re.search(
        r"\n\d+ of \d+ with an interval are told apart; \d\.\d would be by chance if nothing differed\.\n$", printed
    )
    with pytest.raises(UserError, match="another method; give those of both"):
        main(ClaimOptions(results=(docs / "flat_20_million",)))
    with pytest.raises(UserError, match="two of the folders hold sweep results of AI-CPG, seed 0; give one at a time"):
        main(ClaimOptions(results=(docs / "seeds", docs / "flat_20_million")))
    uneven = main(ClaimOptions(results=(docs / "more_seeds_uneven_0",)))
    printed = capsys.readouterr().out
    assert len(printed.splitlines()) == 4 + len(uneven) and "| share that never fell |" in printed
    with pytest.raises(UserError, match=r"there is no sweep.csv and no terrain.csv in"):
        main(ClaimOptions(results=(tmp_path,)))
