"""A control step never waits for the device: nothing is read back and no constant is sent, with resets and without."""

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.env import environment as module
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.methods import METHODS
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.starts import Starts
from aicpg_newton.env.task import Frequencies, Pushes
from aicpg_newton.gait.cpg import PatternNetwork

WAITING = ("_local_scalar_dense", "nonzero", "masked_select", "unique", "lift_fresh", "is_nonzero", "equal", "bincount")
"""Operators that read a number or a size back from the device, or send what was made on the host."""


class Waits(TorchDispatchMode):
    """Counts what a GPU would have to be waited for, and operators that are no views."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.operators = 0

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        """See :class:`TorchDispatchMode`."""
        name = function._schema.name.removeprefix("aten::").rstrip("_")
        self.operators += not function.is_view
        by_mask = "index" in name and any(
            isinstance(each, torch.Tensor) and each.dtype == torch.bool
            for given in args
            if isinstance(given, (list, tuple))
            for each in given
        )
        if name in {each.rstrip("_") for each in WAITING} or name.startswith("_unique") or by_mask:
            self.found.append(name + (" by a mask" if by_mask else ""))
        return function(*args, **(kwargs or {}))


def test_waits_are_found():
    """The ways to wait that a step could fall back into."""
    values, mask = torch.randn(5), torch.tensor([True, False, True, True, False])
    with Waits() as waits:
        assert len(values[mask]) == 3
        values[mask] = 0.0
        mask.nonzero()
        float(values.sum())
        bool(mask.any())
        assert torch.tensor([1.0, 2.0]).sum() == 3.0
        assert len(values[[0, 3]]) == 2
        assert (torch.where(mask, values, 0.0) + values.new_zeros(5)).shape == (5,)
    assert len(waits.found) >= 7 and waits.operators > 8


@pytest.mark.parametrize("uneven", [False, True], ids=["plane", "terrain"])
@pytest.mark.parametrize("method", METHODS)
def test_a_step_waits_for_nothing(
    method: str, uneven: bool, puppet, pattern: PatternNetwork, monkeypatch: pytest.MonkeyPatch
):
    """For as long as it takes that start states are drawn anew, with frequencies that change, pushes and levels."""
    monkeypatch.setattr(module, "reading_is_free", lambda device: False)  # as on a GPU
    task = get_task("flat", method)
    task.frequencies, task.pushes = Frequencies(change_interval=1.0, jumps=0.2), Pushes(force=100.0)
    if uneven:
        task.ground = Ground(height_range=0.1, length=24.0, width=32.0, levels=3, level_strip=True)
    environment = Environment(task, puppet(6, Terrain.make(task.ground)), pattern)
    environment.step(torch.zeros(6, 28))  # makes the constants
    falling = environment.engine.state.root_position.clone()
    falling[2:4, 2] = -1.0
    for ended in (False, True):
        actions = torch.zeros(6, 28)
        environment.engine.overrides = {"root_position": falling} if ended else {}  # type: ignore[attr-defined]
        with Waits() as waits:
            for _ in range(Starts.EVERY + 1):
                environment.step(actions)
        assert environment.outcome.fallen.any() == ended
        assert waits.found == []
        print(f"{method}: {waits.operators / (Starts.EVERY + 1):.0f} operators a step that are no views")
