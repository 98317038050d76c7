"""Settings of a task as plain data, for checkpoints and ``config.yaml``, and back."""

from __future__ import annotations

import dataclasses
import types
import typing
from typing import Any, Literal, TypeVar

from aicpg_newton.env.rewards import RewardTerm
from aicpg_newton.errors import UserError

_Settings = TypeVar("_Settings")

_CODE = ("function", "observations")
"""Fields that hold code: a task's own file gives them."""


def to_dict(settings: Any) -> dict[str, Any]:
    """Nested dictionary of numbers, texts and tuples; functions are left out."""
    return {
        each.name: _content(getattr(settings, each.name))
        for each in dataclasses.fields(settings)
        if each.name not in _CODE
    }


def _content(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return to_dict(value)
    return {key: _content(each) for key, each in value.items()} if isinstance(value, dict) else value


def plain(value: Any) -> Any:
    """The same with lists in the place of tuples, for YAML."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, (list, tuple)) else value


def updated(settings: _Settings, content: Any, source: str) -> _Settings:
    """Settings with the values of :func:`to_dict`; those that it does not hold stay as they are.

    But where it holds reward terms, one that is not among them had no weight.

    Args:
        settings: A task, or a part of one.
        content: Nested dictionary.
        source: Where it comes from, for messages.

    Raises:
        UserError: A setting is unknown, or has the wrong kind of value.
    """
    hints = typing.get_type_hints(type(settings))
    names = {each.name for each in dataclasses.fields(settings)} - set(_CODE)  # type: ignore[arg-type]
    _refuse_unknown(content, names, type(settings).__name__, source)
    values = {}
    for name, value in content.items():
        own, hint = getattr(settings, name), hints[name]
        if isinstance(hint, types.UnionType):  # a kind, or None
            if value is None:
                values[name] = None
                continue
            hint = typing.get_args(hint)[0]
        if dataclasses.is_dataclass(own):
            value = updated(own, value, source)
        elif isinstance(own, dict):
            value = _updated_entries(own, value, name, source)
        elif typing.get_origin(hint) is tuple:
            if not isinstance(value, (list, tuple)):
                raise UserError(f"{source} holds {value!r} for {name}; it should be a list")
            for each in value:
                _check_kind(typing.get_args(hint)[0], each, name, source)
            value = tuple(value)
        elif typing.get_origin(hint) is Literal and not (isinstance(value, str) and value in typing.get_args(hint)):
            raise UserError(f"{source} holds {value!r} for {name}; it should be one of {typing.get_args(hint)}")
        elif hint in (int, float, bool, str):
            _check_kind(hint, value, name, source)
        values[name] = value
    return dataclasses.replace(settings, **values)  # type: ignore[type-var]


def _updated_entries(own: dict[str, Any], content: Any, title: str, source: str) -> dict[str, Any]:
    """Entries of a dictionary: reward terms by name, or the parameters of one."""
    _refuse_unknown(content, set(own), title, source)
    values = dict(own)
    for name, each in own.items():
        if isinstance(each, RewardTerm):
            values[name] = updated(each, content.get(name, {"weight": 0.0}), source)
        elif name in content:
            _check_kind(type(each), content[name], name, source)
            values[name] = content[name]
    return values


def _check_kind(kind: type, value: Any, name: str, source: str) -> None:
    right = isinstance(value, (int, float) if kind is float else kind)
    if not right or (isinstance(value, bool) and kind is not bool):
        raise UserError(f"{source} holds {value!r} for {name}; it should be of type {kind.__name__}")


def _refuse_unknown(content: Any, names: set[str], title: str, source: str) -> None:
    if isinstance(content, dict) and set(content) <= names:
        return
    different = ", ".join(sorted(map(str, set(content) - names))) if isinstance(content, dict) else "no settings"
    raise UserError(
        f"{source} holds settings of another version ({title}: {different}); use the version of the code that wrote it"
    )


def brought_up_to_date(content: dict[str, Any]) -> dict[str, Any]:
    """Content as an earlier version of this package wrote it, in today's words.

    Settings that were not settings once take what was done then; a reward term has its weight and parameters
    beside it; settings of other methods, which every task used to have, and terms that are gone are left out.
    """
    content = dict(content)
    learning = dict(_table(content, "learning"))
    if "adaptive_learning_rate" in learning:  # the schedule's name until there were three
        learning["learning_rate_schedule"] = "minibatch" if learning.pop("adaptive_learning_rate") else "fixed"
    rewards = content.get("rewards")
    if isinstance(rewards, dict) and "weights" in rewards:
        learning["reward_scale"] = rewards["scale"]
        terms = {_RENAMED.get(name, name): {"weight": weight} for name, weight in rewards["weights"].items()}
        terms["pattern_tracking"]["parameters"] = {
            "bound": rewards["pattern_error_bound"],
            "reading": rewards["pattern_error"],
        }
        for name, method in _TERM_OF.items():
            if method != content.get("method", "ai-cpg"):
                terms.pop(name, None)
        for name, methods in _SETTINGS_OF.items():
            if content.get("method", "ai-cpg") not in methods:
                content.pop(name, None)
        content["rewards"] = terms
    if content.get("method") == "amp":
        content.setdefault("drives", "pattern")
        if isinstance(content.get("imitation"), dict):
            content["imitation"] = {"loss": "least_squares", **content["imitation"]}
    if isinstance(content.get("reflex"), dict):
        content["reflex"] = {"unit": "limit", **content["reflex"]}
    if isinstance(content.get("rewards"), dict):
        terms = {name: term for name, term in content["rewards"].items() if name not in _DROPPED}
        energy = terms.get("action_energy")
        if isinstance(energy, dict) and not energy.get("parameters"):
            terms["action_energy"] = {**energy, "parameters": {"velocity_scale": 0.1}}
        content["rewards"] = terms
    if isinstance(content.get("learning"), dict):
        constant = {"final_kl": learning["desired_kl"]} if "desired_kl" in learning else {}
        content["learning"] = {**_BEFORE, **constant, **learning}
    return content


def _table(content: dict[str, Any], name: str) -> dict[str, Any]:
    """A part of the content; empty where it is not there or is no table, which is refused later, by its name."""
    part = content.get(name)
    return part if isinstance(part, dict) else {}


_BEFORE = {
    "value_clipping": True,
    "network": "mlp",
    "learning_rate_schedule": "minibatch",
    "minimum_learning_rate": 1e-5,
    "maximum_learning_rate": 1e-2,
}
"""Learning settings that were not settings once, with what was done then."""

_DROPPED = ("sideways_speed", "turned_away", "bounce")
"""Reward terms that no task has any more: a training that had one can be played, and resumes without it."""

_RENAMED = {"reflex_energy": "action_energy"}
_TERM_OF = {"pattern_tracking": "ai-cpg", "target_speed": "ppo"}
_SETTINGS_OF = {"reflex": ("ai-cpg", "ppo"), "target_speed": ("ppo",), "reference": ("amp",), "imitation": ("amp",)}

_SAME_HUMANOID: dict[str, str] = dict.fromkeys(("60eacc976df0", "5ad37ed817ac"), "5c9e39e9b196")
"""Earlier fingerprints of the same humanoid: of its file, and of its facts without the gears."""


def same_humanoid(fingerprint: str) -> str:
    """A checkpoint's fingerprint of the humanoid, in today's way: see :mod:`aicpg_newton.robot.fingerprint`."""
    return _SAME_HUMANOID.get(fingerprint, fingerprint)
