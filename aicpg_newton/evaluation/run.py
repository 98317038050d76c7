"""Evaluate controllers: any protocol, with any checkpoints, on any engine."""

from __future__ import annotations

import copy
import hashlib
import importlib.metadata
import platform
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

import aicpg_newton
from aicpg_newton import checkpoint, humanoid, metrics
from aicpg_newton.cpg import DEFAULT_PATTERN, PatternNetwork
from aicpg_newton.device import resolve_device
from aicpg_newton.engines import Engine, make_engine
from aicpg_newton.environment import Environment
from aicpg_newton.errors import UserError
from aicpg_newton.evaluation import records, summaries
from aicpg_newton.evaluation.playing import load_policy
from aicpg_newton.evaluation.protocols import COMMAND, DISTURBANCE, PROTOCOLS, SWEEP, TRANSITION, Protocol
from aicpg_newton.evaluation.recording import SHORTEST, WARM_UP, Recording, record
from aicpg_newton.evaluation.summaries import Source
from aicpg_newton.task import Task, task_from_dict

METHOD = "AI-CPG"
"""Method of checkpoints that do not name another one."""


@dataclass
class Controller:
    """One training of a method (its seed), or the CPG alone."""

    method: str
    seed: int
    task: Task
    pattern: PatternNetwork
    files: list[Path] = field(default_factory=list)
    """Checkpoints, oldest first; none for the CPG alone."""

    def description(self) -> dict[str, Any]:
        """What the results say of it: names, seed and the SHA-256 of every checkpoint file."""
        return {
            "method": self.method,
            "seed": self.seed,
            "task": self.task.name,
            "checkpoints": [
                {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()} for path in self.files
            ],
        }


def cpg_alone(task: Task, seed: int) -> Controller:
    """The pattern network without reflexes."""
    return Controller("CPG alone", seed, task, PatternNetwork.load(DEFAULT_PATTERN))


def trained(path: Path, task: Task | None = None) -> Controller:
    """The training that a checkpoint comes from.

    Args:
        path: Checkpoint, or run folder: then its last five, of which most protocols use the last.
        task: Task to be tested on, with the checkpoint's reflex; None for the one it was trained on.

    Raises:
        UserError: A checkpoint is missing, torn or of another version.
    """
    files = checkpoint.all_of(path)[-DISTURBANCE.checkpoints :] if path.is_dir() else [path]
    content = checkpoint.read(files[-1])
    own = task_from_dict(content["task"], str(path))
    if task is not None:
        own = replace(task, reflex=own.reflex, learning=own.learning)
    pattern = PatternNetwork.from_content(content["pattern"], str(path))
    return Controller(content["run"].get("method", METHOD), int(content["run"]["seed"]), own, pattern, files)


@dataclass
class Laboratory:
    """Where controllers are tested; engines are built once for each kind of physics.

    Args:
        num_envs: Number of environments, shared out evenly among a protocol's conditions.
        engine: ``newton``, ``mujoco`` or ``auto``.
        device: Torch device's name, or ``auto``.
        seed: Seed of start states and pushes.
        show: Whether to draw a progress bar on stderr.
    """

    num_envs: int
    engine: str = "auto"
    device: str = "auto"
    seed: int = 0
    show: bool = False

    def __post_init__(self) -> None:
        self._device = resolve_device(self.device)
        self._engines: list[Engine] = []
        self._physics: list[Any] = []

    def engine_of(self, task: Task) -> Engine:
        """The engine with the task's physics."""
        if task.physics not in self._physics:
            engine = make_engine(self.engine, self.num_envs, self._device, humanoid.motors(), task.physics)
            self._physics.append(copy.deepcopy(task.physics))
            self._engines.append(engine)
        return self._engines[self._physics.index(task.physics)]

    def test(
        self, protocol: Protocol, frequencies: torch.Tensor, controller: Controller, file: Path | None
    ) -> tuple[Recording, int]:
        """Run a protocol with one checkpoint; returns the recording and the checkpoint's training iteration."""
        task = copy.deepcopy(controller.task)
        task.pushes = protocol.pushes()
        task.termination.episode_steps = protocol.steps + 1
        environment = Environment(
            task, self.engine_of(task), controller.pattern, humanoid.motors().to(self._device), seed=self.seed
        )
        iteration, agent = 0, _no_reflex
        if file is not None:
            content = checkpoint.read(file)
            iteration, agent = content["iteration"], load_policy(environment, content)
        label = f"{protocol.name:12}{controller.method}, seed {controller.seed}, iteration {iteration}"
        bar = _bar(label, protocol.steps) if self.show else _no_bar
        return record(protocol, frequencies, environment, agent, bar), iteration

    def facts(self) -> dict[str, Any]:
        """Engine, device, seed and versions, for the JSON files."""
        packages = ("torch", "rsl-rl-lib", "newton", "mujoco", "mujoco-warp", "warp-lang", "numpy")
        gpu = torch.cuda.get_device_name(self._device) if self._device.type == "cuda" else None
        return {
            "engine": self._engines[-1].name,
            "device": str(self._device),
            "gpu": gpu,
            "cpu_threads": torch.get_num_threads(),
            "environments": self.num_envs,
            "seed": self.seed,
            "humanoid": humanoid.version(),
            "versions": {
                "aicpg_newton": aicpg_newton.__version__,
                "python": platform.python_version(),
                **{name: importlib.metadata.version(name) for name in packages},
            },
            "environments_out_of_contact_buffers": sum(engine.overflows() for engine in self._engines),
        }


def check(protocols: Sequence[Protocol], controllers: Sequence[Controller], num_envs: int) -> None:
    """Refuse what cannot be evaluated, before any work is done.

    Raises:
        UserError: Too few environments, or two controllers that the results could not tell apart.
    """
    most = max(protocols, key=lambda each: each.conditions)
    if num_envs < most.conditions:
        raise UserError(
            f"--num-envs is {num_envs}, but the {most.name} protocol has {most.conditions} conditions;"
            " give at least one environment each"
        )
    names = [(each.method, each.seed) for each in controllers]
    for name in names:
        if names.count(name) > 1:
            raise UserError(
                f"two checkpoints are of method {name[0]} and seed {name[1]}; give one for each seed, or evaluate them"
                " into two folders"
            )


def evaluate(
    protocols: Sequence[Protocol], controllers: Sequence[Controller], laboratory: Laboratory, folder: Path
) -> None:
    """Run protocols with controllers and write their CSV and JSON files.

    Args:
        protocols: What to do; ``command`` brings the sweep along where the folder holds none.
        controllers: Each of another method or seed.
        laboratory: Where they are tested.
        folder: Where results go; nothing in it is overwritten.

    Raises:
        UserError: The options or the folder do not allow it.
    """
    wanted = {protocol.name: protocol for protocol in protocols}
    if COMMAND.name in wanted and not (folder / f"{SWEEP.name}.csv").exists():
        wanted.setdefault(SWEEP.name, SWEEP)  # whose curve the commands need
    chosen = [wanted[name] for name in PROTOCOLS if name in wanted]
    check(chosen, controllers, laboratory.num_envs)
    identity = [controller.description() for controller in controllers]
    records.prepare(folder, wanted, identity)
    for protocol in chosen:
        began = time.perf_counter()
        rows: list[records.Row] = []
        results = []
        for controller in controllers:
            files: list[Path | None] = [*controller.files[-protocol.checkpoints :]] or [None]
            for file in files:
                new, summary, iteration = _one(protocol, controller, file, laboratory, folder)
                rows += new
                results.append(
                    {"method": controller.method, "seed": controller.seed, "iteration": iteration, **summary}
                )
        description = {
            "protocol": asdict(protocol),
            "controllers": identity,
            **laboratory.facts(),
            "definitions": _definitions(),
            "seconds": round(time.perf_counter() - began, 1),
            "results": results,
        }
        records.write(folder, protocol.name, rows, description)


def _one(
    protocol: Protocol, controller: Controller, file: Path | None, laboratory: Laboratory, folder: Path
) -> tuple[list[records.Row], dict[str, Any], int]:
    """Rows and summary of one checkpoint, and its training iteration."""
    speeds = np.empty(0)
    frequencies = torch.tensor(protocol.frequencies)
    source = Source(controller.method, controller.seed, 0)
    if protocol.commanded_speeds:
        sweep = records.read_table(folder, SWEEP.name)
        speeds, given = summaries.commands(sweep, source, protocol.commanded_speeds)
        if not len(speeds):
            laboratory.engine_of(controller.task)  # the results name it
            return *summaries.no_commands(source), 0
        frequencies = torch.from_numpy(given).float()
    recording, iteration = laboratory.test(protocol, frequencies, controller, file)
    source = replace(source, iteration=iteration)
    if protocol.commanded_speeds:
        rows, summary = summaries.command_rows(recording, frequencies, speeds, source)
    else:
        rows, summary = _READINGS[protocol.name](recording, frequencies, source)
    return rows, summary, iteration


_READINGS: dict[str, Callable[[Recording, torch.Tensor, Source], tuple[list[records.Row], dict[str, Any]]]] = {
    SWEEP.name: summaries.sweep_rows,
    DISTURBANCE.name: summaries.disturbance_rows,
    TRANSITION.name: summaries.transition_rows,
}


def _definitions() -> dict[str, Any]:
    """The numbers behind the measures."""
    return {
        "contact_force_n": metrics.CONTACT_FORCE,
        "least_speed_for_cost_of_transport_mps": metrics.SLOWEST_SPEED,
        "least_denominator_of_symmetry_index_rad": metrics.SMALLEST_ANGLE,
        "steps_not_counted_after_a_start": WARM_UP,
        "fewest_counted_steps": SHORTEST,
        "flight_threshold_in_a_window": summaries.FLIGHT_THRESHOLD,
        "total_mass_kg": humanoid.TOTAL_MASS,
        "leg_length_m": humanoid.LEG_LENGTH,
        "falls": "pelvis low or tilted, or facing away from the target by more than the task's angle",
    }


def _no_reflex(observed: torch.Tensor) -> torch.Tensor:
    """Actions of the CPG alone."""
    return observed.new_zeros(len(observed), humanoid.NUM_JOINTS)


def _no_bar(step: int) -> None:
    """Show nothing."""


def _bar(label: str, steps: int) -> Callable[[int], None]:
    """A progress bar on stderr: in place on a terminal, else one line at the start."""
    began = time.monotonic()
    terminal = sys.stderr.isatty()
    if not terminal:
        print(label, file=sys.stderr, flush=True)

    def draw(step: int) -> None:
        if terminal and (step % 20 == 0 or step == steps):
            rest = (time.monotonic() - began) * (steps - step) / step
            bar = "#" * (20 * step // steps)
            end = "\n" if step == steps else ""
            print(f"\r{label:58} [{bar:20}] {rest:4.0f} s left", end=end, file=sys.stderr, flush=True)

    return draw
