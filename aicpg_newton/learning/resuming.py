"""The rest of a training's state, beside its checkpoint: with it a resumed run is bit for bit the uninterrupted one.

A checkpoint holds what is learned, and a run keeps many of them; where the robots are and what the random generators
draw next grows with the number of environments (1.6 kB each) and is of use to the newest alone. So it is a file
of its own, ``state_<iteration>.pt`` beside ``model_<iteration>.pt``, of which a run folder keeps one, and which nobody
has to take out before a checkpoint is published.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Protocol

import torch

from aicpg_newton.env.environment import Environment
from aicpg_newton.env.stored import to_dict
from aicpg_newton.errors import UserError
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.ppo import BoundedPPO
from aicpg_newton.tensor_files import read_tensors

FORMAT = 2

_NAME = re.compile(r"state_(\d+)\.pt")
_SAME = {"num_envs": "the number of environments", "engine": "the engine", "device": "the device"}
"""Facts of a run that its state goes with."""


class Training(Protocol):
    """What goes on: the runner, as far as its state is concerned."""

    env: Environment
    alg: BoundedPPO
    logger: Any
    run: dict[str, Any]
    device: str
    is_distributed: bool
    current_learning_iteration: int


def beside(model: Path) -> Path:
    """The file of the state that goes with a checkpoint."""
    return model.with_name("state_" + model.name.removeprefix("model_"))


def write(runner: Training, model: Path) -> None:
    """Write the state that goes with a checkpoint which is about to be written.

    Raises:
        UserError: The disk does not take it.
    """
    logger = runner.logger
    content = {
        "training_state": FORMAT,
        "task": to_dict(runner.env.task),
        "run": runner.run,
        "iteration": runner.current_learning_iteration + 1,
        "environment": runner.env.state_dict(),
        "algorithm": runner.alg.state_beside_networks(),
        "logger": {
            "rewards": list(logger.rewbuffer),
            "lengths": list(logger.lenbuffer),
            "reward_sums": logger.cur_reward_sum,
            "episode_lengths": logger.cur_episode_length,
            "seconds": logger.tot_time,
        },
        "generators": _generators(runner.device),
    }
    checkpoint.save(content, beside(model))


def drop_older(model: Path) -> None:
    """Remove states of other checkpoints than this one, which is on the disk by now."""
    for path in model.parent.glob("state_*.pt"):
        if _NAME.fullmatch(path.name) and path != beside(model):
            path.unlink(missing_ok=True)


def restore(runner: Training, model: Path) -> str:
    """Put robots, random generators and logs where they were, as the last thing before a run goes on.

    Args:
        runner: What goes on, with the checkpoint's networks.
        model: The checkpoint.

    Returns:
        Why that was not possible, as the end of a sentence; empty where it was.

    Raises:
        UserError: The state is not what this version of the code writes.
    """
    if runner.is_distributed:
        return "several processes train together"
    path = beside(model)
    if not path.is_file():
        return f"there is no {path.name} beside it"
    try:
        content = read_tensors(path, "the state of a training", "delete it")
    except UserError:
        return f"{path.name} cannot be read"
    if not isinstance(content, dict) or content.get("training_state") != FORMAT:
        return f"{path.name} is of another version"
    changed = [words for name, words in _SAME.items() if content["run"][name] != runner.run[name]]
    before, now = ({**task, "learning": None} for task in (content["task"], to_dict(runner.env.task)))
    settings = [name for name in now if before.get(name) != now[name]]
    changed += [f"settings of {', '.join(settings)}"] if settings else []
    try:
        if changed:
            kept = ", each on the level of the ground that it had reached" if _keep_levels(runner, content) else ""
            return f"{' and '.join(changed)} changed{kept}"
        _take_over(runner, content)
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise UserError(f"{path} does not fit this run; delete it to resume with robots that begin anew") from error
    return ""


def _keep_levels(runner: Training, content: dict[str, Any]) -> bool:
    """Let robots begin anew on the levels of a state, where ground and robots are as many; whether that is so.

    Otherwise a change of the reward alone would send all of them back to level ground, and they would unlearn the rest.
    """
    env, level = runner.env, content["environment"]["level"]
    if env.task.ground.levels < 2 or content["task"]["ground"] != to_dict(env.task)["ground"]:
        return False
    if level.shape != env.level.shape:
        return False
    env.level = level.to(env.level.device)
    env.restart(env.commands.frequency)
    return True


def _take_over(runner: Training, content: dict[str, Any]) -> None:
    """Put everything of a state where it belongs."""
    runner.env.load_state_dict(content["environment"])
    runner.alg.load_state_beside_networks(content["algorithm"])
    logger, logged = runner.logger, content["logger"]
    logger.rewbuffer.extend(logged["rewards"])
    logger.lenbuffer.extend(logged["lengths"])
    logger.cur_reward_sum.copy_(logged["reward_sums"])
    logger.cur_episode_length.copy_(logged["episode_lengths"])
    logger.tot_time = logged["seconds"]
    for name, state in content["generators"].items():
        _module(name).set_rng_state(state)


def _generators(device: torch.device | str) -> dict[str, Any]:
    """State of torch's own random generators on the CPU and the device of the networks."""
    names = {"cpu", torch.device(device).type}
    return {name: _module(name).get_rng_state() for name in sorted(names)}


def _module(device: str) -> Any:
    """What holds a device's random generator."""
    return torch if device == "cpu" else torch.get_device_module(device)
