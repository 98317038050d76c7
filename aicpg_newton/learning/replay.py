"""A ring of what the policy did in earlier iterations."""

from __future__ import annotations

from typing import Any

import torch


class ReplayBuffer:
    """Keeps pairs of style states; when full, new pairs overwrite the oldest.

    Args:
        size: Number of pairs that fit.
        state_size: Length N of a style state.
        device: Where the pairs are kept.
    """

    def __init__(self, size: int, state_size: int, device: torch.device | str) -> None:
        self._pairs = torch.zeros(size, 2, state_size, device=device)
        self._position = 0
        self._count = 0

    @property
    def size(self) -> int:
        """Number of pairs that fit."""
        return len(self._pairs)

    @property
    def full(self) -> bool:
        """Whether the next pair overwrites one."""
        return self._count == self.size

    @property
    def pairs(self) -> torch.Tensor:
        """What is kept, shape [count, 2, N]."""
        return self._pairs[: self._count]

    def add(self, pairs: torch.Tensor) -> None:
        """Write pairs, shape [batch, 2, N] with batch no larger than the ring."""
        places = (self._position + torch.arange(len(pairs), device=pairs.device)) % self.size
        self._pairs[places] = pairs
        self._position = (self._position + len(pairs)) % self.size
        self._count = min(self._count + len(pairs), self.size)

    def state_dict(self) -> dict[str, Any]:
        """What is kept, where the next pair goes, and how many fit."""
        return {"pairs": self.pairs.clone(), "position": self._position, "size": self.size}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from :meth:`state_dict`.

        Raises:
            ValueError: It was written by a ring of another size.
        """
        pairs = state["pairs"]
        if state["size"] != self.size or pairs.shape[1:] != self._pairs.shape[1:]:
            raise ValueError("the stored replay buffer is of another size")
        self._count, self._position = len(pairs), state["position"]
        self._pairs[: self._count] = pairs.to(self._pairs)
