"""Robots whose simulation has gone wrong: how that is seen, counted and kept to be looked into.

It may go wrong without leaving the numbers: a body that moves at 1e4 m/s earned a thousand times the reward once.
Whoever is affected is reset alone; nobody waits for the device to say who that is.
"""

from __future__ import annotations

import torch

from aicpg_newton.engines.interface import RobotState

CAUSES: tuple[str, ...] = ("not_finite", "too_fast", "too_high", "overflow")
"""Causes; of several the first counts: numbers that are none, motion that no body is capable of, and contacts that did
not fit into a buffer, which may be full for all robots because of one that bursts."""

WORDS = {
    "not_finite": "not finite",
    "too_fast": "faster than any body",
    "too_high": "far above the ground",
    "overflow": "out of contact buffers",
}
"""The causes as a sentence has them."""

_FASTEST, _FASTEST_TURN, _FASTEST_JOINT = 50.0, 100.0, 500.0
"""Speeds of the pelvis [m/s], [rad/s] and of a joint [rad/s] that no body reaches, falling and stumbling included."""

_HIGHEST = 10.0
"""Height of the pelvis above the ground [m] that no jump reaches."""


def cause_of(state: RobotState, height: torch.Tensor, overflowed: torch.Tensor) -> torch.Tensor:
    """What is wrong with each robot's simulation.

    Args:
        state: The robots after a step.
        height: Height of each pelvis above the ground [m], shape [num_envs].
        overflowed: :attr:`aicpg_newton.engines.Engine.overflowed` of the step.

    Returns:
        0 for nothing, otherwise 1 and the place of the first cause in :data:`CAUSES`, shape [num_envs].
    """
    too_fast = (
        (state.root_linear_velocity.norm(dim=1) > _FASTEST)
        | (state.root_angular_velocity.norm(dim=1) > _FASTEST_TURN)
        | (state.joint_velocity.abs().amax(dim=1) > _FASTEST_JOINT)
    )
    found = (~state.finite(), too_fast, height > _HIGHEST, overflowed)
    cause = torch.zeros_like(overflowed, dtype=torch.long)
    for number, mask in reversed(tuple(enumerate(found, start=1))):
        cause = cause.masked_fill(mask, number)
    return cause


class FaultCount:
    """Counts robots whose simulation went wrong, by cause.

    Args:
        num_envs: Number of robots.
        device: Where the counts are kept.
    """

    def __init__(self, num_envs: int, device: torch.device | str) -> None:
        self._numbers = torch.arange(1, len(CAUSES) + 1, device=device).unsqueeze(1)
        self._counts = torch.zeros(len(CAUSES), num_envs, dtype=torch.long, device=device)  # summed when asked for

    def note(self, cause: torch.Tensor) -> None:
        """Count what :func:`cause_of` found in a step."""
        self._counts = self._counts + (cause == self._numbers)

    def take(self) -> dict[str, int]:
        """The counts since the last time, by cause; on a GPU this waits for it."""
        counts = dict(zip(CAUSES, self._counts.sum(dim=1).tolist(), strict=True))
        self._counts = torch.zeros_like(self._counts)
        return counts


def sentence(counts: dict[str, int]) -> str:
    """What is to be said about counts by cause; empty where nothing went wrong."""
    total = sum(counts.values())
    if not total:
        return ""
    causes = ", ".join(f"{number} {WORDS[cause]}" for cause, number in counts.items() if number)
    advice = "; raise physics.max-contacts and physics.max-constraints" if counts["overflow"] else ""
    return f"Simulations that went wrong and were reset: {total} ({causes}){advice}."


class BadStates:
    """Keeps each robot's first bad step until it is asked for: what the step began from, and its cause.

    Args:
        num_envs: Number of robots.
        device: Where it is kept.
    """

    def __init__(self, num_envs: int, device: torch.device | str) -> None:
        self._cause = torch.zeros(num_envs, dtype=torch.long, device=device)
        self._kept: dict[str, torch.Tensor] = {}

    def note(self, cause: torch.Tensor, before: dict[str, torch.Tensor]) -> None:
        """Keep those that went wrong for the first time.

        Args:
            cause: What :func:`cause_of` found in a step.
            before: What the step began from and was given, each of shape [num_envs, ...].
        """
        first = (cause > 0) & (self._cause == 0)
        self._cause = torch.where(first, cause, self._cause)
        self._kept = {
            name: torch.where(first.view(-1, *(1,) * (value.ndim - 1)), value, self._kept.get(name, value))
            for name, value in before.items()
        }

    def take(self) -> dict[str, torch.Tensor]:
        """Rows of what went wrong since the last time, with ``robot`` and ``cause``; on a GPU this waits for it."""
        rows = self._cause.nonzero().flatten()
        kept = {"robot": rows, "cause": self._cause[rows], **{name: each[rows] for name, each in self._kept.items()}}
        self._cause = torch.zeros_like(self._cause)
        return {name: each.cpu() for name, each in kept.items()}
