"""Train a network: python train.py --task flat, or aicpg-train with the wheel. See --help for every setting."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Generic, TypeVar

import tyro

from aicpg_newton.env.methods import DEFAULT_METHOD
from aicpg_newton.env.registry import TASKS, get_task
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.learning.plan import RunOptions, task_of, with_networks_of
from aicpg_newton.learning.training import train

_Settings = TypeVar("_Settings", bound=Task)


@dataclass(kw_only=True)
class Arguments(Generic[_Settings]):
    """Train the reflex network of AI-CPG, or a baseline, by PPO, on a GPU if there is one."""

    task: str
    """flat, uneven or robust; its settings are the defaults of the options below."""
    method: str
    """ai-cpg, ppo or amp: how the humanoid is controlled and learns; changes some of those defaults. See --target-speed
    for ppo and --reference for amp."""
    run: Annotated[RunOptions, tyro.conf.arg(name="")]
    settings: Annotated[_Settings, tyro.conf.arg(name="")]


def defaults(arguments: list[str]) -> Arguments:
    """Defaults of all options: those of ``--task`` and ``--method``, or of the checkpoint that ``--resume`` names.

    Networks and the reward's scale are as in the checkpoint that ``--start-from`` names.

    Raises:
        UserError: The task or the method is unknown, or the checkpoint cannot be read or is of another one.
    """
    first_look = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first_look.add_argument("--task")
    first_look.add_argument("--method")
    first_look.add_argument("--resume", type=Path)
    first_look.add_argument("--start-from", type=Path)
    given, _ = first_look.parse_known_args(arguments)
    if given.resume is None:
        settings = get_task(given.task or next(iter(TASKS)), given.method or DEFAULT_METHOD)
        if given.start_from is not None:
            settings = with_networks_of(settings, given.start_from)
    else:
        settings = task_of(given.resume)
        for name, wanted, own in (("task", given.task, settings.name), ("method", given.method, settings.method)):
            if wanted not in (None, own):
                raise UserError(
                    f"--{name} is {wanted}, but {given.resume} was trained with {own}; leave it out, or begin a new run"
                    " with --start-from"
                )
    return Arguments(task=settings.name, method=settings.method, run=RunOptions(), settings=settings)


def main() -> None:
    """Read the command line and train."""
    arguments = sys.argv[1:]
    default = defaults(arguments)
    chosen = tyro.cli(
        Arguments[type(default.settings)],  # the options of the method are the fields of its own task
        args=arguments,
        default=default,
        description=__doc__,
        config=(tyro.conf.OmitSubcommandPrefixes,),
    )
    chosen.settings.refuse_idle_changes(default.settings)
    train(chosen.settings, chosen.run)


def command() -> None:
    """What ``train.py`` and ``aicpg-train`` do."""
    run_command(main, alone=False)


if __name__ == "__main__":
    command()
