"""AI-CPG beside the other methods at the same speed, over seeds: python -m aicpg_newton.claims --results FOLDER."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from aicpg_newton.errors import UserError, run_command
from aicpg_newton.evaluation import claims, results
from aicpg_newton.evaluation.protocols import DISTURBANCE, SWEEP


@dataclass(kw_only=True)
class ClaimOptions:
    """Which results."""

    results: tuple[Path, ...]
    """Folders of evaluate or compare, together all methods: each with a sweep.csv, and a disturbance.csv for falls."""


def main(options: ClaimOptions) -> list[claims.Comparison]:
    """Compare, and print the table.

    Raises:
        UserError: A folder holds no sweep, two hold the same training, or there is nothing to compare.
    """
    missing = [folder for folder in options.results if not (folder / f"{SWEEP.name}.csv").exists()]
    if missing:
        raise UserError(f"there is no {missing[0] / SWEEP.name}.csv; run the sweep protocol first")
    sweep, disturbance = (results.read_together(options.results, name) for name in (SWEEP.name, DISTURBANCE.name))
    comparisons = claims.compare(sweep, disturbance)
    if not any(row["method"] == claims.OURS for row in sweep) or not comparisons:
        raise UserError(f"the folders do not hold {claims.OURS} and another method; give those of both")
    print(claims.table(comparisons))
    return comparisons


def command() -> None:
    """What ``python -m aicpg_newton.claims`` does."""
    run_command(lambda: main(tyro.cli(ClaimOptions, description=__doc__)))


if __name__ == "__main__":
    command()
