"""A control step leaves no tensor on the CPU: on a device of its own it meets none there.

Torch's device ``meta`` stands for the GPU: its tensors know their shape and device, and no numbers.
"""

from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.methods import METHODS
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.starts import Starts
from aicpg_newton.env.task import Frequencies, Pushes
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.robot.humanoid import Motors

ELSEWHERE = torch.device("meta")

SENDING = ("_to_copy", "copy")
"""Operators that may see two devices."""


class GeneratorElsewhere(torch.Generator):
    """A generator that says it is on the other device, where there are no random numbers."""

    def __new__(cls, device: Any = None):
        """See :class:`torch.Generator`."""
        assert torch.device(device) == ELSEWHERE
        return super().__new__(cls)

    device = ELSEWHERE  # type: ignore[assignment]


class WithoutGenerators(TorchFunctionMode):
    """Draws without a generator, once it has been seen to be on the right device."""

    def __torch_function__(self, function, types, args=(), kwargs=None):
        """See :class:`TorchFunctionMode`."""
        given = dict(kwargs or {})
        generator = given.pop("generator", None)
        if generator is not None:
            assert torch.device(given["device"]) == generator.device
        return function(*args, **given)


class OneDevice(TorchDispatchMode):
    """Raises where tensors of two devices meet; numbers in a tensor without dimensions may be anywhere, as on a GPU."""

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        """See :class:`TorchDispatchMode`."""
        name = function._schema.name.removeprefix("aten::").rstrip("_")
        tensors = [each for each in tree_leaves((args, kwargs)) if isinstance(each, torch.Tensor)]
        devices = {each.device for each in tensors if each.dim() or each.device == ELSEWHERE}
        if len(devices) > 1 and name not in SENDING:
            raise AssertionError(f"{name} meets tensors on {sorted(map(str, devices))}")
        return function(*args, **(kwargs or {}))


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Within it, tensors on ``meta`` are as if they were on a GPU."""
    monkeypatch.setattr(torch, "Generator", GeneratorElsewhere)
    monkeypatch.setattr(Motors, "__post_init__", lambda self: None)  # it looks at the numbers, once in a training
    with OneDevice(), WithoutGenerators():
        yield


def test_tensors_on_two_devices_are_found(elsewhere: None):
    """In arithmetic, as a mask, as an index; and a number that is read from the device."""
    there, here = torch.zeros(3, device=ELSEWHERE), torch.zeros(3)
    for meet in (
        lambda: there + here,
        lambda: torch.where(here > 0, there, 0.0),
        lambda: there[here.long()],
        lambda: torch.cat((there, here)),
    ):
        with pytest.raises((AssertionError, RuntimeError), match="meta"):
            meet()
    with pytest.raises(RuntimeError, match="meta"):
        bool(there.any())
    assert (there + torch.ones(())).device == (there + here.to(ELSEWHERE)).device == ELSEWHERE


@pytest.mark.parametrize("uneven", [False, True], ids=["plane", "terrain"])
@pytest.mark.parametrize("method", METHODS)
def test_a_step_stays_on_its_device(method: str, uneven: bool, puppet, elsewhere: None):
    """Start, steps until start states are drawn anew, resets, with changing frequencies, pushes and levels."""
    task = get_task("flat", method)
    task.frequencies, task.pushes = Frequencies(change_interval=1.0, jumps=0.2), Pushes(force=100.0)
    if uneven:
        task.ground = Ground(height_range=0.1, length=24.0, width=32.0, levels=3, level_strip=True)
    terrain = Terrain.make(task.ground)
    engine = puppet(6, None if terrain is None else terrain.to(ELSEWHERE))
    engine.device, engine.overflowed = ELSEWHERE, engine.overflowed.to(ELSEWHERE)
    engine.state = type(engine.state)(**{name: value.to(ELSEWHERE) for name, value in vars(engine.state).items()})
    environment = Environment(task, engine, PatternNetwork.load())
    for _ in range(Starts.EVERY + 1):
        observed, reward, dones, extras = environment.step(torch.zeros(6, 28, device=ELSEWHERE))
        environment.command(heading=torch.zeros(6, device=ELSEWHERE))
    for value in (reward, dones, *observed.values(), *extras["log"].values(), extras["time_outs"]):
        assert value.device == ELSEWHERE
