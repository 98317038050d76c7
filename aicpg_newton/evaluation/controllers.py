"""What is evaluated: trainings of the methods, and the CPG alone."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from aicpg_newton.env.methods import condition, get_method, on_task
from aicpg_newton.env.task import Task
from aicpg_newton.evaluation.protocols import PROTOCOLS
from aicpg_newton.evaluation.transition_summaries import TRANSITION_FROUDE
from aicpg_newton.gait.cpg import DEFAULT_PATTERN, PatternNetwork
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.policy import Trained
from aicpg_newton.robot.locomotion import froude_number


@dataclass
class Controller:
    """One training of a method (its seed and condition), or the CPG alone."""

    method: str
    """Title of the method."""
    seed: int
    task: Task
    """Task to be tested on, with the settings of the method."""
    pattern: PatternNetwork
    files: list[Path] = field(default_factory=list)
    """Checkpoints, oldest first; none for the CPG alone."""
    terrain_seed: int | None = None
    """Seed of the terrain it was trained on; None if that was a plane."""

    @property
    def follows_frequency(self) -> bool:
        """Whether it can be told a stride frequency."""
        return get_method(self.task.method).follows_frequency

    @property
    def condition(self) -> str:
        """What it was trained for, as ``1.5`` or ``run``; empty where a stride frequency tells."""
        return condition(self.task)

    @property
    def gait(self) -> str:
        """``walking`` or ``running`` where it has only one: that of the speed it was trained for; else empty."""
        if self.follows_frequency:
            return ""
        clips = {gait.name: gait.speed for gait in self.pattern.gaits}
        speed = clips[self.condition] if self.condition in clips else float(self.condition)
        return "walking" if froude_number(torch.tensor(speed)) < TRANSITION_FROUDE else "running"

    @property
    def title(self) -> str:
        """Its name in messages."""
        return " ".join(text for text in (self.method, self.condition) if text) + f", seed {self.seed}"

    def description(self) -> dict[str, Any]:
        """What the results say of it: names, seed, ground and the SHA-256 of every checkpoint that a test may take."""
        tested = {path for protocol in PROTOCOLS.values() for path in protocol.pick(self.files)}
        return {
            "method": self.method,
            "condition": self.condition,
            "seed": self.seed,
            "task": self.task.name,
            "checkpoints": [
                {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
                for path in self.files
                if path in tested
            ],
        }


def cpg_alone(task: Task, seed: int) -> Controller:
    """The pattern network without reflexes."""
    return Controller("CPG alone", seed, task, PatternNetwork.load(DEFAULT_PATTERN))


def trained(path: Path, task: Task | None = None) -> Controller:
    """The training that a checkpoint comes from.

    Args:
        path: Checkpoint, or run folder for all of its checkpoints, of which most protocols use the last.
        task: Task to be tested on, with the checkpoint's method; None for the one it was trained on.

    Raises:
        UserError: A checkpoint is missing, torn or of another version.
    """
    files = checkpoint.all_of(path) if path.is_dir() else [path]
    last = Trained.read(files[-1])
    checkpoint.require_run(last.content, files[-1])
    own = last.task
    return Controller(
        method=get_method(own.method).title,
        seed=last.content["run"]["seed"],
        task=own if task is None else on_task(own, task),
        pattern=last.pattern,
        files=files,
        terrain_seed=own.ground.seed if own.ground.uneven else None,
    )


def ground_of(task: Task, terrain_seeds: tuple[int, ...]) -> dict[str, Any] | None:
    """What the results say of the ground; None for a plane."""
    ground = asdict(task.ground)
    del ground["seed"], ground["levels"], ground["level_strip"]
    return {**ground, "terrain_seeds": list(terrain_seeds)} if task.ground.uneven else None
