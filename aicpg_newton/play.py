"""Play a trained network: python play.py --checkpoint runs/flat/.../model_2999.pt, or aicpg-play with the wheel."""

from __future__ import annotations

import tyro

from aicpg_newton.env.registry import get_task
from aicpg_newton.errors import run_command
from aicpg_newton.playing.options import PlayOptions
from aicpg_newton.playing.play import play


def main() -> None:
    """Read the command line and play."""
    options = tyro.cli(PlayOptions, description=__doc__)
    play(options, get_task(options.task or "flat"))


def command() -> None:
    """What ``play.py`` and ``aicpg-play`` do."""
    run_command(main)


if __name__ == "__main__":
    command()
