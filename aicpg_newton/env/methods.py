"""The ways to control and to learn that can be compared, as data: AI-CPG and the paper's two baselines.

All that differs between them stands here and in the classes named here; humanoid, engine, control rate, torque limits,
networks, number of samples and falls are the same.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

from aicpg_newton.env.actuation import Actuation, PatternActuation, TargetActuation, TorqueActuation
from aicpg_newton.env.rewards import RewardTerm, pattern_terms, speed_terms
from aicpg_newton.env.stored import to_dict, updated
from aicpg_newton.env.task import ImitationTask, Learning, ReflexTask, SpeedTask, Task
from aicpg_newton.errors import UserError


@dataclass(frozen=True)
class Method:
    """A way to control the humanoid and to learn it."""

    title: str
    """Name in results and figures."""
    task: type[Task]
    """Its task's settings: those of every task, and its own."""
    actuation: type[Actuation]
    """What an action does, and what comes with that."""
    rewards: Callable[[], dict[str, RewardTerm]] = dict
    """Reward terms that come on top of the task's."""
    learning: Callable[[Learning], Learning] = lambda learning: learning
    """The task's learning settings where they have to differ."""
    algorithm: str = "aicpg_newton.learning.ppo:BoundedPPO"
    """rsl_rl's algorithm, or the class that takes its place."""
    algorithm_settings: Callable[[Task], dict[str, Any]] = lambda task: {}
    """What that class is given besides PPO's settings."""
    follows_frequency: bool = True
    """Whether the stride frequency does anything."""
    condition: str | None = None
    """Setting of the task that tells one training of the method from another; None where one network does all."""


def _amp_learning(learning: Learning) -> Learning:
    """Less exploration at the start: 0.1 of a target's reach is 4 to 12 degrees of every joint in every step.

    Published is a fixed exp(-2.9). With the learned one everything else is as it is for the other methods.
    """
    return replace(learning, initial_std=0.1)


def _amp_settings(task: Task) -> dict[str, Any]:
    task = cast(ImitationTask, task)
    return {"reference_gait": task.reference, **to_dict(task.imitation)}


DEFAULT_METHOD = "ai-cpg"

METHODS = {
    DEFAULT_METHOD: Method(title="AI-CPG", task=ReflexTask, actuation=PatternActuation, rewards=pattern_terms),
    "ppo": Method(
        title="PPO",
        task=SpeedTask,
        actuation=TorqueActuation,
        rewards=speed_terms,
        follows_frequency=False,
        condition="target_speed",
    ),
    "amp": Method(
        title="AMP",
        task=ImitationTask,
        actuation=TargetActuation,
        learning=_amp_learning,
        algorithm_settings=_amp_settings,
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
    """A task made complete by a method: its settings, its reward terms, its learning.

    Args:
        task: What a file in ``tasks/`` says. Terms of methods that it has already count as they are there, and those of
            other methods not at all.
        choice: A method's name, or name and condition as ``ppo:1.5`` and ``amp:run``.

    Raises:
        UserError: There is no such method, or it has no such condition.
    """
    name, _, wanted = choice.partition(":")
    method = get_method(name)
    own = {each.name: getattr(task, each.name) for each in dataclasses.fields(Task)}
    terms = method.rewards()
    foreign = {each for other in METHODS.values() for each in other.rewards()} - set(terms)
    said = {each: term for each, term in task.rewards.items() if each not in foreign}
    complete = method.task(
        **{
            **own,
            "method": name,
            "rewards": said | {each: said.get(each, term) for each, term in terms.items()},
            "learning": method.learning(task.learning),
        }
    )
    if not wanted:
        return complete
    if method.condition is None:
        raise UserError(f"method {name} has no conditions; give {name} in place of {choice!r}")
    try:
        value = type(getattr(complete, method.condition))(wanted)
    except ValueError as error:
        raise UserError(f"{choice!r} does not give a number for {method.condition}") from error
    complete = updated(complete, {method.condition: value}, f"method {choice!r}")
    complete.validate()
    return complete


def condition(task: Task) -> str:
    """The task's condition as text, as ``1.5`` or ``run``; empty where one network does all."""
    field = get_method(task.method).condition
    return "" if field is None else str(getattr(task, field))


def run_name(task: Task) -> str:
    """Name of a task's training in file names: ``flat``, ``flat_ppo_1.5``, ``uneven_amp_run``."""
    own = [] if task.method == DEFAULT_METHOD else [task.method, condition(task)]
    return "_".join((task.name, *own))


def on_task(own: Task, other: Task) -> Task:
    """Another task's ground, commands, rewards and falls with the method and networks of a training's own task.

    Args:
        own: Task of the training.
        other: Any task; what a method made of it does not count.
    """
    taken = ("name", "ground", "frequencies", "resets", "termination", "pushes", "physics")
    rewards = {name: other.rewards.get(name, term) for name, term in own.rewards.items()}
    return replace(own, rewards=rewards, **{name: getattr(other, name) for name in taken})
