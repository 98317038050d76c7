"""The ways to control and to learn that can be compared, as data: AI-CPG and the paper's two baselines.

All that differs between them stands here and in the classes named here; humanoid, engine, control rate, torque limits,
networks, number of samples and falls are the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

from aicpg_newton.env.actuation import Actuation, PatternActuation, TargetActuation, TorqueActuation
from aicpg_newton.env.task import Task, task_from_dict
from aicpg_newton.errors import UserError
from aicpg_newton.robot import humanoid


@dataclass(frozen=True)
class Method:
    """A way to control the humanoid and to learn it."""

    title: str
    """Name in results and figures."""
    actuation: type[Actuation]
    """What an action does, and what comes with that."""
    motors: Callable[[], humanoid.Motors] = humanoid.motors
    """Gains, limits and damping."""
    settings: Callable[[Task], Task] = lambda task: task
    """The task's settings where they have to differ."""
    algorithm: str = "aicpg_newton.learning.ppo:BoundedPPO"
    """rsl_rl's algorithm, or the class that takes its place."""
    algorithm_settings: Callable[[Task], dict[str, Any]] = lambda task: {}
    """What that class is given besides PPO's settings."""
    follows_frequency: bool = True
    """Whether the stride frequency does anything."""
    condition: str | None = None
    """Setting of the task that tells one training of the method from another; None where one network does all."""


def _amp(task: Task) -> Task:
    """The published fixed standard deviation of exp(-2.9), and with that fewer updates at a small fixed learning rate.

    With so small a deviation the KL divergence, by which the learning rate is adapted, and the policy ratios of mirror
    images tell nothing any more; equivariant networks have not been tried. Published are 5e-5 and 6 x 2 updates on 16
    times as many samples. The shipped network had 3 x 4 updates on 32 steps an iteration, as many for each sample.
    """
    learning = replace(
        task.learning,
        network="mlp",
        initial_std=0.055,
        learn_std=False,
        learning_rate=1e-4,
        epochs=3,
        minibatches=2,
        learning_rate_schedule="fixed",
        symmetry=False,
    )
    return replace(task, learning=learning)


DEFAULT_METHOD = "ai-cpg"

METHODS = {
    DEFAULT_METHOD: Method(title="AI-CPG", actuation=PatternActuation),
    "ppo": Method(
        title="PPO",
        actuation=TorqueActuation,
        motors=humanoid.torque_motors,
        follows_frequency=False,
        condition="target_speed",
    ),
    "amp": Method(
        title="AMP",
        actuation=TargetActuation,
        settings=_amp,
        algorithm_settings=lambda task: {"reference_gait": task.reference, **asdict(task.imitation)},
        algorithm="aicpg_newton.learning.amp:AdversarialMotionPriors",
        follows_frequency=False,
        condition="reference",
    ),
}
"""Method of each name that ``--method`` takes."""


def get_method(name: str) -> Method:
    """The method of that name.

    Raises:
        UserError: There is none.
    """
    if name not in METHODS:
        raise UserError(f"unknown method {name!r}; choose one of: {', '.join(METHODS)}")
    return METHODS[name]


def with_method(task: Task, choice: str) -> Task:
    """A task with the settings of a method.

    Args:
        task: Task of the registry.
        choice: A method's name, or name and condition as ``ppo:1.5`` and ``amp:run``.

    Raises:
        UserError: There is no such method, or it has no such condition.
    """
    name, _, wanted = choice.partition(":")
    method = get_method(name)
    task = method.settings(replace(task, method=name))
    if not wanted:
        return task
    if method.condition is None:
        raise UserError(f"method {name} has no conditions; give {name} in place of {choice!r}")
    content = asdict(task)
    try:
        content[method.condition] = type(content[method.condition])(wanted)
    except ValueError as error:
        raise UserError(f"{choice!r} does not give a number for {method.condition}") from error
    changed = task_from_dict(content, f"method {choice!r}")
    changed.validate()
    return changed


def condition(task: Task) -> str:
    """The task's condition as text, as ``1.5`` or ``run``; empty where one network does all."""
    field = get_method(task.method).condition
    return "" if field is None else str(getattr(task, field))


def run_name(task: Task) -> str:
    """Name of a task's training in file names: ``flat``, ``flat_ppo_1.5``, ``uneven_amp_run``."""
    own = [] if task.method == DEFAULT_METHOD else [task.method, condition(task)]
    return "_".join((task.name, *own))


def on_task(own: Task, other: Task) -> Task:
    """Another task's ground, commands, rewards and falls with the method and networks of a training's own task."""
    field = get_method(own.method).condition
    kept = ("method", "reflex", "learning", *(() if field is None else (field,)))
    return replace(other, **{name: getattr(own, name) for name in kept})
