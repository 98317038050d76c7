"""Checkpoints: one file that holds all that is needed to play, judge or resume a run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import torch

from aicpg_newton import places
from aicpg_newton.env.stored import same_humanoid
from aicpg_newton.errors import UserError
from aicpg_newton.files import WholeFile
from aicpg_newton.robot.fingerprint import fingerprint
from aicpg_newton.tensor_files import Unreadable, read_tensors, write_tensors

FORMAT = 1
"""Raised when the content changes its meaning."""

_KEYS = {"format", "humanoid", "task", "pattern", "run", "iteration", "samples", "algorithm"}
_KINDS = {
    "humanoid": str,
    "task": dict,
    "pattern": dict,
    "run": dict,
    "iteration": int,
    "samples": int,
    "algorithm": dict,
}
_OF_A_RUN = ("seed", "num_envs")
_LATER = {"observations"}
"""Keys that checkpoints of the first version do not have."""
_NAME = re.compile(r"model_(\d+)\.pt")


def write(
    path: Path,
    *,
    task: dict[str, Any],
    pattern: dict[str, Any],
    observations: list[list],
    run: dict[str, Any],
    iteration: int,
    samples: int,
    algorithm: dict[str, Any],
) -> None:
    """Write a checkpoint; the file appears whole or not at all, or as :func:`save` says.

    Args:
        path: File to write.
        task: The task's settings, from :func:`aicpg_newton.env.stored.to_dict`.
        pattern: :meth:`PatternNetwork.content`.
        observations: Layout of what the networks see, from :func:`aicpg_newton.env.observations.layout`.
        run: How it was trained: number of environments, engine, device, seed, git revision.
        iteration: Iterations done.
        samples: Control steps seen over all environments.
        algorithm: State of actor, critic (with their normalisers) and optimiser.
    """
    content = {
        "format": FORMAT,
        "humanoid": fingerprint(),
        "task": task,
        "pattern": pattern,
        "observations": observations,
        "run": run,
        "iteration": iteration,
        "samples": samples,
        "algorithm": algorithm,
    }
    save(content, path)


class Found(NamedTuple):
    """A checkpoint that was looked for."""

    path: Path
    content: dict[str, Any]
    """As :func:`write` was given it."""
    skipped: list[str]
    """Sentences about newer checkpoints of the folder that cannot be read."""


def read(path: Path) -> dict[str, Any]:
    """Read a checkpoint written by :func:`write`, and say which newer ones were skipped; as :func:`find`."""
    found = find(path)
    for sentence in found.skipped:
        print(sentence)
    return found.content


def find(path: Path) -> Found:
    """Read a checkpoint, or of a run folder the newest that can be read.

    Args:
        path: Checkpoint or run folder.

    Raises:
        UserError: The file is missing, torn, of another format or trained on another humanoid; none in a folder is
            whole.
    """
    if not path.is_dir():
        return Found(path, _read(path), [])
    files = all_of(path)[::-1]
    skipped = []
    for each in files:
        try:
            return Found(each, _read(each), skipped)
        except Unreadable:
            reason = "is empty" if each.stat().st_size == 0 else "cannot be read and may be cut short"
            skipped.append(f"Skipped {each}: it {reason}.")
    raise Unreadable(f"none of the {len(files)} checkpoints in {path} can be read; begin a new run")


def _read(path: Path) -> dict[str, Any]:
    """Read one file."""
    if not path.is_file():
        raise UserError(f"no checkpoint at {path}; give a model_*.pt file or a run folder that holds one")
    content = read_tensors(path, "a checkpoint", "delete it to go on from the one before")
    if not isinstance(content, dict) or content.get("format") != FORMAT or set(content) - _LATER != _KEYS:
        raise UserError(f"{path} is not a checkpoint of this version of aicpg_newton; use the version that wrote it")
    for name, kind in _KINDS.items():
        if not isinstance(content[name], kind) or isinstance(content[name], bool):
            raise UserError(f"{path} holds no {kind.__name__} for {name}; it is broken, fetch it again")
    told = [content["run"][name] for name in _OF_A_RUN if name in content["run"]]
    if any(not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**32 for value in told):
        raise UserError(
            f"{path} holds no numbers for {' and '.join(_OF_A_RUN)} of its run; it is broken, fetch it again"
        )
    if min(content["iteration"], content["samples"]) < 0:
        raise UserError(f"{path} was trained for fewer than no iterations; it is broken, fetch it again")
    content["humanoid"] = same_humanoid(content["humanoid"])
    if content["humanoid"] != fingerprint():
        raise UserError(
            f"{path} was trained on humanoid {content['humanoid'][:12]}, but this is {fingerprint()};"
            " check out the revision that trained it or train again"
        )
    return content


def require_run(content: dict[str, Any], path: Path) -> None:
    """Refuse to go on with, or to judge, what does not say how it was trained.

    Raises:
        UserError: It does not.
    """
    missing = [name for name in _OF_A_RUN if name not in content["run"]]
    if missing:
        raise UserError(f"{path} does not say the {missing[0]} of its run; it can be played, not resumed or judged")


def average(path: Path, number: int) -> dict[str, Any]:
    """A checkpoint without optimiser whose networks are means over several of its run.

    Late in a training the gait wanders about what is best for it, and the mean of weights lies nearer to that (B. T.
    Polyak and A. B. Juditsky, SIAM J. Control Optim. 30, 1992); docs/robust.md has what it brings.

    Args:
        path: Checkpoint in a run folder, or the folder for its newest.
        number: How many checkpoints: this one and those before it.

    Returns:
        Content of that checkpoint with these networks; ``average_of`` in its ``run`` has the iterations.

    Raises:
        UserError: The run has fewer checkpoints, one cannot be read, or they are of different networks.
    """
    last = latest(path) if path.is_dir() else path
    before = [each for each in all_of(last.parent) if _number(each) < _number(last)]
    files = [*before, last][-number:]
    if len(files) < number:
        raise UserError(f"{last.parent} holds {len(files)} checkpoints up to {last.name}; average no more than these")
    contents = [without_optimiser(_read(each)) for each in files]
    content = contents[-1]
    try:
        algorithm = {
            name: {key: _mean([each["algorithm"][name][key] for each in contents]) for key in networks}
            for name, networks in content["algorithm"].items()
        }
    except (KeyError, RuntimeError) as error:
        raise UserError(f"the checkpoints in {last.parent} are of different networks; average fewer") from error
    run = {**content["run"], "average_of": [each["iteration"] for each in contents]}
    return {**content, "run": run, "algorithm": algorithm}


def _mean(values: list[torch.Tensor]) -> torch.Tensor:
    """Mean of tensors of one shape; of whole numbers, as a counter is one, the last."""
    if not values[-1].is_floating_point():
        return values[-1]
    return torch.stack(values).double().mean(dim=0).to(values[-1].dtype)


def without_optimiser(content: dict[str, Any]) -> dict[str, Any]:
    """A checkpoint's content at a third of its size, actor and critic alone: it can be played and judged, not resumed.

    Args:
        content: What :func:`read` returned.
    """
    networks = ("actor_state_dict", "critic_state_dict")
    if not set(networks) <= set(content["algorithm"]):
        raise UserError("the checkpoint holds no actor and critic; it is broken, fetch it again")
    algorithm = {name: content["algorithm"][name] for name in networks}
    return {**content, "algorithm": algorithm}


def save(content: dict[str, Any], path: Path) -> None:
    """Write a checkpoint's content; the file appears whole or not at all.

    Raises:
        UserError: The disk does not take it.
    """
    with WholeFile(path) as temporary:
        write_tensors(content, temporary)


def shipped(task: str) -> Path:
    """The trained checkpoint that comes with this repository for a task.

    Raises:
        UserError: There is none.
    """
    path = places.ASSETS / "policies" / f"{task}.pt"
    if not path.is_file():
        raise UserError(f"no trained policy ships for task {task!r}; train one and give --checkpoint")
    return path


def best_for(task: str) -> Path:
    """The shipped network that does best on a task: the robust one, which goes on all of them, if it is there.

    Raises:
        UserError: None ships.
    """
    try:
        return shipped("robust")
    except UserError:
        return shipped(task)


def all_of(folder: Path) -> list[Path]:
    """The checkpoints of a run folder, oldest first.

    Raises:
        UserError: The folder holds none.
    """
    found = [path for path in folder.glob("model_*.pt") if _NAME.fullmatch(path.name)]
    if not found:
        raise UserError(f"no model_*.pt in {folder}; give a run folder that holds a checkpoint")
    return sorted(found, key=_number)


def _number(path: Path) -> int:
    """Iteration in a checkpoint's name."""
    match = _NAME.fullmatch(path.name)
    if match is None:
        raise UserError(f"{path.name} is not named as a checkpoint of a run; give a model_*.pt file in its run folder")
    return int(match[1])


def latest(folder: Path) -> Path:
    """The checkpoint of a run folder with the highest iteration.

    Raises:
        UserError: The folder holds none.
    """
    return all_of(folder)[-1]
