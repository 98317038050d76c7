"""Put a trained checkpoint into assets/policies, to ship it: python -m aicpg_newton.publish.

play.py and evaluate find a task's network there by themselves; a baseline's file has to be named.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
import yaml

from aicpg_newton.env.methods import run_name
from aicpg_newton.env.registry import task_from_dict
from aicpg_newton.env.stored import plain, to_dict
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.evaluation import results
from aicpg_newton.evaluation.controllers import trained
from aicpg_newton.evaluation.protocols import SWEEP
from aicpg_newton.evaluation.run import Laboratory, evaluate
from aicpg_newton.files import make_folder, temporary_folder, write_text
from aicpg_newton.learning import checkpoint
from aicpg_newton.places import ASSETS
from aicpg_newton.ranges import AT_LEAST_ONE, ENVIRONMENTS, check_ranges


@dataclass(kw_only=True)
class PublishOptions:
    """Ship a checkpoint without its optimiser, and its run's configuration beside it."""

    checkpoint: Path
    """model_*.pt in a run folder, or the run folder for its latest."""
    average: Annotated[int, AT_LEAST_ONE] = 1
    """Ship the mean of the networks of so many checkpoints of the run: this one and those before it."""
    out: Path = ASSETS / "policies"
    """Folder to write <task>.pt and <task>.yaml into; a baseline's names go on with method and condition."""
    replace: bool = False
    """Put it in the place of the network that ships under that name; without, both are only shown side by side."""
    num_envs: Annotated[int | None, ENVIRONMENTS] = None
    """Robots that old and new are tested with; 32 for each frequency when not given."""
    device: str = "auto"
    """auto, cpu or cuda:N."""
    engine: str = "auto"
    """newton, mujoco, or auto: newton on CUDA and mujoco on a CPU."""


def publish(options: PublishOptions) -> Path:
    """Write the shipped checkpoint and its configuration, if none would be lost.

    Raises:
        UserError: The checkpoint cannot be read, or a network ships under its name and is not to be replaced.
    """
    check_ranges(options, "--")
    content = checkpoint.without_optimiser(
        checkpoint.read(options.checkpoint)
        if options.average == 1
        else checkpoint.average(options.checkpoint, options.average)
    )
    # The checkpoint's own, as a run that was resumed with other settings has several config.yaml.
    task = task_from_dict(content["task"], str(options.checkpoint))
    content = {**content, "run": without_machine(content["run"])}
    config = {
        "run": content["run"],
        "humanoid": content["humanoid"],
        "task": plain(to_dict(task)),
        "trained": {"iterations": content["iteration"], "samples": content["samples"]},
    }
    target = options.out / f"{run_name(task)}.pt"
    taken = [path for path in (target, target.with_suffix(".yaml")) if path.exists()]
    if target.exists():
        print(side_by_side(target, content, options))
    if taken and not options.replace:
        raise UserError(f"{taken[0]} ships already and stays as it is; give --replace to put this one in its place")
    make_folder(options.out)
    checkpoint.save(content, target)
    write_text(target.with_suffix(".yaml"), yaml.safe_dump(config, sort_keys=False))
    print(f"wrote {target} and {target.with_suffix('.yaml')}")
    return target


_MACHINE_PATH = re.compile(r"(?<!\S)(?:~|[A-Za-z]:)?[/\\](?:\S*[/\\])?([^\s/\\]+)[/\\]*(?=\s|$)")
"""An absolute path in a text; what remains of it is its last name."""


def without_machine(value: Any) -> Any:
    """Records of a run without the folders of the machine that it ran on."""
    if isinstance(value, dict):
        return {key: without_machine(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(without_machine(each) for each in value)
    return _MACHINE_PATH.sub(r"\1", value) if isinstance(value, str) else value


_SHOWN = {
    "survived": "never fell",
    "speed_mps": "speed [m/s]",
    "flight_ratio": "flight",
    "symmetry_index": "asymmetry",
    "cost_of_transport": "cost of transport",
}


def _cell(row: results.Row | None, name: str) -> str:
    """A measure with two digits; a dash where there is none."""
    return f"{row[name]:.2f}" if row and math.isfinite(row[name]) else "-"


def side_by_side(old: Path, content: dict[str, Any], options: PublishOptions) -> str:
    """A table of the sweep with the network that ships and with the new one: old, then new, for each measure."""
    tables: list[dict[float, results.Row] | None] = []
    with temporary_folder() as folder:
        checkpoint.save(content, folder / "new.pt")
        for name, path in (("old", old), ("new", folder / "new.pt")):
            try:
                controller = trained(path)
                laboratory = Laboratory(options.num_envs, options.engine, options.device, show=True)
                evaluate([SWEEP], [controller], laboratory, folder / name)
                rows = results.read_table(folder / name, SWEEP.name)
                tables.append({row["frequency_hz"]: row for row in rows})
            except UserError as error:
                if name == "new":
                    raise
                print(f"What ships cannot be tested: {error}")
                tables.append(None)
    before, after = tables
    assert after is not None
    lines = ["f [Hz]" + "".join(f"{title:>20}" for title in _SHOWN.values()), " " * 6 + f"{'old':>12}{'new':>8}" * 5]
    for (frequency, new), was in zip(after.items(), (before or dict.fromkeys(after)).values(), strict=True):
        cells = [f"{_cell(was, name):>12}{_cell(new, name):>8}" for name in _SHOWN]
        lines.append(f"{frequency:6.2f}" + "".join(cells))
    return "\n".join(lines)


if __name__ == "__main__":
    run_command(lambda: publish(tyro.cli(PublishOptions, description=__doc__)))
