"""AI-CPG beside the other methods, over seeds: python -m aicpg_newton.claims --results FOLDER."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from aicpg_newton.errors import UserError, run_command
from aicpg_newton.evaluation import claims, results
from aicpg_newton.evaluation.protocols import DISTURBANCE, SWEEP, TERRAIN


@dataclass(kw_only=True)
class ClaimOptions:
    """Which results."""

    results: tuple[Path, ...]
    """Folders of evaluate or compare, together all methods: each with a sweep.csv, and a disturbance.csv for falls, to
    compare at the same speed; or with a terrain.csv, to compare on uneven ground in the same gait."""


def main(options: ClaimOptions) -> list[claims.Comparison]:
    """Compare, and print for each kind of ground a table and what chance has to do with it.

    Raises:
        UserError: A folder holds no such results, two hold the same training, or there is nothing to compare.
    """
    for folder in options.results:
        if not any((folder / f"{protocol.name}.csv").exists() for protocol in (SWEEP, TERRAIN)):
            raise UserError(f"there is no sweep.csv and no terrain.csv in {folder}; run one of these protocols first")
    sweep, disturbance, terrain = (
        results.read_together(options.results, protocol.name) for protocol in (SWEEP, DISTURBANCE, TERRAIN)
    )
    grounds = ((claims.compare(sweep, disturbance), sweep), (claims.compare_on_terrain(terrain), terrain))
    tables = [found for found, rows in grounds if found and any(row["method"] == claims.OURS for row in rows)]
    if not tables:
        raise UserError(f"the folders do not hold {claims.OURS} and another method; give those of both")
    print("\n\n".join(f"{claims.table(found)}\n\n{claims.by_chance(found)}" for found in tables))
    return [comparison for found in tables for comparison in found]


def command() -> None:
    """What ``python -m aicpg_newton.claims`` does."""
    run_command(lambda: main(tyro.cli(ClaimOptions, description=__doc__)))


if __name__ == "__main__":
    command()
