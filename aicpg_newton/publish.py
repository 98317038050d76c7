"""Put a trained checkpoint into assets/policies, to ship it: python -m aicpg_newton.publish.

play.py and evaluate find a task's network there by themselves; a baseline's file has to be named.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
import yaml

from aicpg_newton.env.methods import run_name
from aicpg_newton.env.registry import task_from_dict
from aicpg_newton.env.stored import plain, to_dict
from aicpg_newton.errors import run_command
from aicpg_newton.files import write_text
from aicpg_newton.learning import checkpoint
from aicpg_newton.places import ASSETS


@dataclass(kw_only=True)
class PublishOptions:
    """Ship a checkpoint without its optimiser, and its run's configuration beside it."""

    checkpoint: Path
    """model_*.pt in a run folder, or the run folder for its latest."""
    out: Path = ASSETS / "policies"
    """Folder to write <task>.pt and <task>.yaml into; a baseline's names go on with method and condition."""


def publish(options: PublishOptions) -> Path:
    """Write the shipped checkpoint and its configuration.

    Raises:
        UserError: The checkpoint cannot be read.
    """
    content = checkpoint.read(options.checkpoint)
    # The checkpoint's own, as a run that was resumed with other settings has several config.yaml.
    task = task_from_dict(content["task"], str(options.checkpoint))
    config = {
        "run": content["run"],
        "humanoid": content["humanoid"],
        "task": plain(to_dict(task)),
        "trained": {"iterations": content["iteration"], "samples": content["samples"]},
    }
    options.out.mkdir(parents=True, exist_ok=True)
    target = options.out / f"{run_name(task)}.pt"
    checkpoint.save(checkpoint.without_optimiser(content), target)
    write_text(target.with_suffix(".yaml"), yaml.safe_dump(config, sort_keys=False))
    print(f"wrote {target} and {target.with_suffix('.yaml')}")
    return target


if __name__ == "__main__":
    run_command(lambda: publish(tyro.cli(PublishOptions, description=__doc__)))
