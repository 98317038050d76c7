"""Play a trained network: python play.py --checkpoint runs/flat/.../model_2999.pt. See --help for every option."""

from __future__ import annotations

import tyro

from aicpg_newton.errors import run_command
from aicpg_newton.playing.options import PlayOptions
from aicpg_newton.playing.play import play
from tasks import get_task


def main() -> None:
    """Read the command line and play."""
    options = tyro.cli(PlayOptions, description=__doc__)
    play(options, get_task(options.task or "flat"))


if __name__ == "__main__":
    run_command(main)
