"""The ring of earlier motion."""

import pytest
import torch

from aicpg_newton.learning.replay import ReplayBuffer


def numbered(first: int, count: int) -> torch.Tensor:
    """Pairs whose numbers all are their index."""
    return torch.arange(first, first + count, dtype=torch.float).reshape(-1, 1, 1).expand(-1, 2, 3)


def kept(replay: ReplayBuffer) -> list[int]:
    """Indices of what is kept, in the order of the ring."""
    return replay.pairs[:, 0, 0].int().tolist()


def test_wraps_around():
    """Grows until it is full, then the oldest go first."""
    replay = ReplayBuffer(5, 3, "cpu")
    assert len(replay.pairs) == 0 and not replay.full
    replay.add(numbered(0, 3))
    assert kept(replay) == [0, 1, 2] and not replay.full
    replay.add(numbered(3, 4))
    assert kept(replay) == [5, 6, 2, 3, 4] and replay.full
    replay.add(numbered(7, 1))
    assert kept(replay) == [5, 6, 7, 3, 4]
    replay.add(numbered(8, 5))
    assert sorted(kept(replay)) == [8, 9, 10, 11, 12]


@pytest.mark.parametrize("before", [2, 8])
def test_a_restored_ring_goes_on_at_the_same_place(before: int):
    """Half full or wrapped around; what was saved is a copy."""
    replay, restored = ReplayBuffer(5, 3, "cpu"), ReplayBuffer(5, 3, "cpu")
    replay.add(numbered(0, min(before, 5)))
    replay.add(numbered(5, max(0, before - 5)))
    state = replay.state_dict()
    restored.add(numbered(90, 5))
    for ring in (replay, restored):
        if ring is restored:
            ring.load_state_dict(state)
        ring.add(numbered(20, 2))
    assert kept(replay) == kept(restored)
    assert replay.full == restored.full


def test_another_size_is_refused():
    """Of the ring, or of the states in it."""
    state = ReplayBuffer(5, 3, "cpu").state_dict()
    for other in (ReplayBuffer(6, 3, "cpu"), ReplayBuffer(5, 4, "cpu")):
        with pytest.raises(ValueError, match="another size"):
            other.load_state_dict(state)
