"""Step again what went wrong in a training with --dump-bad-states: python -m aicpg_newton.bad_states."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from aicpg_newton.env.faults import CAUSES, WORDS
from aicpg_newton.errors import run_command
from aicpg_newton.learning.bad_states import read, step_again


@dataclass(kw_only=True)
class BadStatesOptions:
    """Take each robot's bad step once more from its last good state, and say what comes of it."""

    file: Path
    """bad_states_<iteration>.pt in a run folder."""


def show(options: BadStatesOptions) -> None:
    """Print a line for each robot: what went wrong then, and what comes of the same step now.

    Raises:
        UserError: The file cannot be read.
    """
    content = read(options.file)
    robots = content["robots"]
    engine, now = step_again(content, str(options.file))
    print(f"{content['task']['name']}, engine {content['engine']}, iteration {content['iteration']}")
    for row, cause in enumerate(now):
        then = WORDS[CAUSES[int(robots["cause"][row]) - 1]]
        speed = engine.state.root_linear_velocity[row].norm()
        print(f"robot {int(robots['robot'][row])}: {then}; again: {WORDS.get(cause, 'sound')}, at {speed:.4g} m/s")


if __name__ == "__main__":
    run_command(lambda: show(tyro.cli(BadStatesOptions, description=__doc__)))
