"""Evaluate controllers: any protocol, with any checkpoints, on any engine."""

from __future__ import annotations

import copy
import importlib.metadata
import platform
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch

import aicpg_newton
from aicpg_newton.device import resolve_device
from aicpg_newton.engines import Engine
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from aicpg_newton.evaluation import metrics, results, summaries, terrain_summaries, transition_summaries
from aicpg_newton.evaluation.controllers import Controller, ground_of
from aicpg_newton.evaluation.protocols import (
    DISTURBANCE,
    PROTOCOLS,
    SLOWING,
    SPEED,
    SWEEP,
    TERRAIN,
    TERRAIN_SEEDS,
    TRAINING,
    TRANSITION,
    UP_AND_DOWN,
    Protocol,
    environments_for,
)
from aicpg_newton.evaluation.summaries import Source
from aicpg_newton.evaluation.trajectories import SHORTEST, WARM_UP, Trajectories, record
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.policy import load_policy
from aicpg_newton.playing.rollout import no_action
from aicpg_newton.robot import humanoid
from aicpg_newton.robot.fingerprint import fingerprint
from aicpg_newton.robot.humanoid import CONTROL_RATE
from aicpg_newton.robot.locomotion import CONTACT_FORCE

_IDLE = 1.0  # stride frequency of the rhythm generator where nothing follows it [Hz]


@dataclass
class Laboratory:
    """Where controllers are tested; engines are built once for each kind of physics, ground and motors.

    Args:
        num_envs: Number of environments, shared out evenly among a protocol's groups; None for as many as these ask
            for.
        engine: ``newton``, ``mujoco`` or ``auto``.
        device: Torch device's name, or ``auto``.
        seed: Seed of start states and pushes.
        show: Whether to draw a progress bar on stderr.
        terrain_seeds: Seeds of the ground; on a plane they change nothing.
        physics_rate: Physics steps a second [Hz]; None for 240, or the training's own if that is more.
    """

    num_envs: int | None = None
    engine: str = "auto"
    device: str = "auto"
    seed: int = 0
    show: bool = False
    terrain_seeds: tuple[int, ...] = TERRAIN_SEEDS
    physics_rate: int | None = None

    def __post_init__(self) -> None:
        self._device = resolve_device(self.device)
        self._engines: list[Engine] = []
        self._worlds: list[Any] = []

    def environments(self, groups: int) -> int:
        """Number of environments for so many groups."""
        return self.num_envs or environments_for(groups)

    def engine_of(self, task: Task, number: int) -> Engine:
        """The engine with the task's physics, ground and motors, for so many environments."""
        from aicpg_newton.env.environment import engine_for  # here: it takes seconds to load, and options may be wrong

        motors = [values.tolist() for values in vars(task.motors()).values()]
        world = (task.physics, task.ground, motors, number)
        if world not in self._worlds:
            self._engines.append(engine_for(task, self.engine, number, self._device))
            self._worlds.append(copy.deepcopy(world))
        return self._engines[self._worlds.index(world)]

    def test(
        self,
        protocol: Protocol,
        frequencies: torch.Tensor,
        controller: Controller,
        content: dict[str, Any] | None,
        terrain_seed: int,
    ) -> Trajectories:
        """Run a protocol with one checkpoint.

        Args:
            protocol: What is done.
            frequencies: Stride frequency of each group [Hz]; NaN for a controller that follows none.
            controller: Who is tested.
            content: Content of the checkpoint; None for no reflexes.
            terrain_seed: Seed of the ground, unless that is a plane.
        """
        from aicpg_newton.env.environment import Environment

        task = on_terrain(controller.task.undisturbed(), terrain_seed)
        task.pushes = protocol.pushes()
        if self.physics_rate is not None:
            task.physics = replace(task.physics, substeps=self.physics_rate // round(CONTROL_RATE))
        task.termination.episode_steps = protocol.steps + 1
        engine = self.engine_of(task, self.environments(len(frequencies)))
        environment = Environment(task, engine, controller.pattern, seed=self.seed)
        agent = no_action if content is None else load_policy(environment, content)
        label = f"{protocol.name:12}{controller.title}, iteration {0 if content is None else content['iteration']}"
        if protocol.every_terrain:
            label += f", terrain {terrain_seed}"
        bar = _bar(label, protocol.steps) if self.show else _no_bar
        return record(protocol, torch.nan_to_num(frequencies, nan=_IDLE), environment, agent, bar)

    def facts(self) -> dict[str, Any]:
        """Engine, device, seed and versions, for the JSON files."""
        packages = ("torch", "rsl-rl-lib", "newton", "mujoco", "mujoco-warp", "warp-lang", "numpy")
        gpu = torch.cuda.get_device_name(self._device) if self._device.type == "cuda" else None
        return {
            "engine": self._engines[-1].name,
            "physics_rate_hz": sorted({round(1.0 / physics.timestep) for physics, *_ in self._worlds}),
            "device": str(self._device),
            "gpu": gpu,
            "cpu_threads": torch.get_num_threads(),
            "seed": self.seed,
            "humanoid": fingerprint(),
            "versions": {
                "aicpg_newton": aicpg_newton.__version__,
                "python": platform.python_version(),
                **{name: importlib.metadata.version(name) for name in packages},
            },
            "environments_out_of_contact_buffers": sum(engine.overflows() for engine in self._engines),
        }


def on_terrain(task: Task, terrain_seed: int) -> Task:
    """A copy of a task on the terrain of this seed, with its full heights everywhere; a plane stays one."""
    task = copy.deepcopy(task)
    if task.ground.uneven:
        task.ground = task.ground.unseen(terrain_seed)
    return task


def check(protocols: Sequence[Protocol], controllers: Sequence[Controller], laboratory: Laboratory) -> None:
    """Refuse what cannot be evaluated, before any work is done.

    Raises:
        UserError: Too few environments, controllers that the results could not tell apart or compare, terrain that a
            controller was trained on, or a protocol without what it needs.
    """
    most = max(protocols, key=lambda each: each.groups)
    needed = most.groups if any(controller.follows_frequency for controller in controllers) else 1
    if laboratory.num_envs is not None and laboratory.num_envs < needed:
        raise UserError(
            f"--num-envs is {laboratory.num_envs}, but the {most.name} protocol has {needed} groups;"
            " give at least one environment each"
        )
    titles = [controller.title for controller in controllers]
    for title in titles:
        if titles.count(title) > 1:
            raise UserError(
                f"two checkpoints are of {title}; give one for each seed and condition, or evaluate them into two"
                " folders"
            )
    grounds = [ground_of(controller.task, laboratory.terrain_seeds) for controller in controllers]
    if any(ground != grounds[0] for ground in grounds):
        raise UserError("the checkpoints were trained on different ground; say with --task which one to test on")
    if grounds[0] is not None:
        _check_terrain(controllers, laboratory.terrain_seeds)
    for protocol in protocols:
        if protocol.every_terrain and grounds[0] is None:
            raise UserError(f"the {protocol.name} protocol needs uneven ground; give --task uneven")
        single = [controller.title for controller in controllers if len(controller.files) < 2]
        if protocol.whole_training and single:
            raise UserError(
                f"the {protocol.name} protocol goes through the checkpoints of a training, and {single[0]} has no more"
                " than one; give --checkpoint its run folder"
            )


def _check_terrain(controllers: Sequence[Controller], terrain_seeds: tuple[int, ...]) -> None:
    """Refuse seeds that cannot be, or that a controller was trained on."""
    if len(set(terrain_seeds)) < len(terrain_seeds):
        raise UserError(f"--terrain-seed is {terrain_seeds}; give each seed once")
    for controller in controllers:
        for terrain_seed in terrain_seeds:
            on_terrain(controller.task.undisturbed(), terrain_seed).validate()
        if controller.terrain_seed in terrain_seeds:
            raise UserError(
                f"{controller.title} was trained on the terrain of seed {controller.terrain_seed}; give other"
                " --terrain-seed, so that it has never seen the ground"
            )


def evaluate(
    protocols: Sequence[Protocol], controllers: Sequence[Controller], laboratory: Laboratory, folder: Path
) -> None:
    """Run protocols with controllers and write their CSV and JSON files.

    Args:
        protocols: What to do; ``speed`` brings the sweep along where the folder holds none. Controllers that follow
            no stride frequency are left out where it is turned.
        controllers: Each of another method, condition or seed; all on the same ground.
        laboratory: Where they are tested.
        folder: Where results go; nothing in it is overwritten.

    Raises:
        UserError: The options or the folder do not allow it.
    """
    check(protocols, controllers, laboratory)
    wanted = {each.name: each for each in protocols if _participants(each, controllers)}
    if not wanted:
        raise UserError(
            f"the {protocols[0].name} protocol turns the stride frequency, which {controllers[0].title} does not"
            " follow; choose another protocol"
        )
    if SPEED.name in wanted and not (folder / f"{SWEEP.name}.csv").exists():
        wanted.setdefault(SWEEP.name, SWEEP)  # whose curve the commands need
        check([SWEEP], controllers, laboratory)
    identity = identity_of(controllers, laboratory)
    results.prepare(folder, wanted, identity)
    for protocol in protocols:
        out = [controller.title for controller in controllers if controller not in _participants(protocol, controllers)]
        if out:
            print(
                f"The {protocol.name} protocol turns the stride frequency; left out, as they follow none:"
                f" {'; '.join(out)}.",
                file=sys.stderr,
            )
    for protocol in [wanted[name] for name in PROTOCOLS if name in wanted]:
        began = time.perf_counter()
        rows: list[results.Row] = []
        entries = []
        for controller in _participants(protocol, controllers):
            files: list[Path | None] = [*protocol.pick(controller.files)] or [None]
            for file in files:
                new, result = _one(protocol, controller, file, laboratory, folder)
                rows += new
                entries.append(result)
        description = {
            "protocol": asdict(protocol),
            "controllers": identity,
            **laboratory.facts(),
            "definitions": _definitions(),
            "seconds": round(time.perf_counter() - began, 1),
            "results": entries,
        }
        results.write(folder, protocol.name, rows, description)


def identity_of(controllers: Sequence[Controller], laboratory: Laboratory) -> list[dict[str, Any]]:
    """What tells results from those of other controllers or ground."""
    return [
        {**controller.description(), "ground": ground_of(controller.task, laboratory.terrain_seeds)}
        for controller in controllers
    ]


def _participants(protocol: Protocol, controllers: Sequence[Controller]) -> list[Controller]:
    """Controllers that can do what a protocol asks for."""
    return [each for each in controllers if each.follows_frequency or not protocol.turns_the_frequency]


def _one(
    protocol: Protocol, controller: Controller, file: Path | None, laboratory: Laboratory, folder: Path
) -> tuple[list[results.Row], dict[str, Any]]:
    """Rows and entry in ``results`` of one checkpoint."""
    content = None if file is None else checkpoint.read(file)
    iteration = 0 if content is None else int(content["iteration"])
    source = Source(controller.method, controller.seed, iteration, controller.condition, controller.gait)
    frequencies = torch.tensor(protocol.frequencies if controller.follows_frequency else (torch.nan,))
    reading = _READINGS.get(protocol.name)
    rows: list[results.Row] = []
    summary: dict[str, Any] = {}
    first, *others = laboratory.terrain_seeds
    if reading is None:
        sweep = results.read_table(folder, SWEEP.name)
        speeds, given = summaries.speeds_to_command(sweep, source, protocol.commanded_speeds)
        if len(speeds):
            frequencies = torch.from_numpy(given).float()
            trajectories = laboratory.test(protocol, frequencies, controller, content, first)
            rows, summary = summaries.speed_rows(trajectories, frequencies, speeds, source)
        else:
            laboratory.engine_of(on_terrain(controller.task, first), 1)  # the results name it
            rows, summary = summaries.no_speeds(source)
    else:
        for terrain_seed in (first, *(others if protocol.every_terrain else ())):
            trajectories = laboratory.test(protocol, frequencies, controller, content, terrain_seed)
            new, summary = reading(trajectories, frequencies, replace(source, terrain_seed=terrain_seed))
            rows += new
        if protocol.every_terrain:
            summary = terrain_summaries.over_terrains(rows)
    names = {"method": controller.method, "condition": controller.condition, "seed": controller.seed}
    number = laboratory.environments(len(frequencies))
    return rows, {**names, "iteration": iteration, "environments": number, **summary}


_READINGS: dict[str, Callable[[Trajectories, torch.Tensor, Source], tuple[list[results.Row], dict[str, Any]]]] = {
    SWEEP.name: summaries.sweep_rows,
    DISTURBANCE.name: summaries.disturbance_rows,
    TRANSITION.name: transition_summaries.transition_rows,
    SLOWING.name: transition_summaries.slowing_rows,
    UP_AND_DOWN.name: transition_summaries.up_and_down_rows,
    TERRAIN.name: terrain_summaries.terrain_rows,
    TRAINING.name: terrain_summaries.training_rows,
}
"""What is read off each protocol; speeds to command come from the sweep."""


def _definitions() -> dict[str, Any]:
    """The numbers behind the measures."""
    return {
        "contact_force_n": CONTACT_FORCE,
        "least_speed_for_cost_of_transport_mps": metrics.SLOWEST_SPEED,
        "least_denominator_of_symmetry_index_rad": metrics.SMALLEST_ANGLE,
        "steps_not_counted_after_a_start": WARM_UP,
        "fewest_counted_steps": SHORTEST,
        "flight_threshold_in_a_window": transition_summaries.FLIGHT_THRESHOLD,
        "total_mass_kg": humanoid.TOTAL_MASS,
        "leg_length_m": humanoid.LEG_LENGTH,
        "points_along_and_across_a_sole": metrics.SOLE_GRID,
        "falls": "pelvis low or tilted by the task's limits",
        "turned_away": "no fall, but facing away from the target by more than the task's angle; ends the episode, too",
        "power": "motor torque of each physics step times the mean of the joint velocities before and after it",
    }


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
