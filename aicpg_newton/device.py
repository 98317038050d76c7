"""Which device to run on, and on how many CPU threads torch works there."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Generic, Literal, ParamSpec, TypeVar

import torch

from aicpg_newton import launcher
from aicpg_newton.errors import UserError

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

Compile = Literal["auto", "on", "off"]
"""Whether to compile what stands around the physics; ``auto``: on a GPU with Triton."""


def resolve_device(name: str) -> torch.device:
    """Torch device of a name; ``auto`` is a GPU, or the CPU with a line that says so.

    The GPU that is meant where none is named is the first; of several processes on a machine each has its own.

    Args:
        name: ``auto``, ``cpu``, ``cuda`` or ``cuda:N``.

    Raises:
        UserError: The name is unknown, names a GPU that is not there, or one GPU for several processes.
    """
    place = launcher.place()
    if name == "auto":
        if not torch.cuda.is_available():
            print("No CUDA device found: running on the CPU.")
            return torch.device("cpu")
        name = "cuda"
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise UserError(f"unknown device {name!r}; choose auto, cpu or cuda:0") from error
    if device.type == "cpu":
        return torch.device("cpu")
    if device.type != "cuda":
        raise UserError(f"device {name!r} is not supported; choose auto, cpu or cuda:0")
    if device.index is not None and place.local_size > 1:
        raise UserError(f"device {name!r} is one GPU, but {place.local_size} processes run here; give --device cuda")
    index = place.local_rank if device.index is None else device.index
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if index >= count:
        raise UserError(f"device 'cuda:{index}' is not there (CUDA devices found: {count}); use --device cpu")
    return torch.device("cuda", index)


def resolve_learner_device(name: str | None, engine: str, device: torch.device) -> torch.device:
    """Device of the networks, which may be another one than that of the physics where the physics is on the CPU.

    Args:
        name: ``cpu``, ``cuda:N`` or ``mps``; None for the device of the physics.
        engine: Name of the engine.
        device: Device of the physics.

    Raises:
        UserError: There is no such device, or the physics is not on the CPU.
    """
    if name is None or name == str(device):
        return device
    if engine != "mujoco":
        raise UserError(
            f"--learner-device {name} goes with --engine mujoco, which runs on the CPU; engine {engine!r} on {device}"
            " keeps the networks beside it, so leave it out"
        )
    if name == "mps":
        if not torch.backends.mps.is_available():
            raise UserError("--learner-device mps is not there: it takes a Mac with Metal; leave it out")
        return torch.device("mps")
    if name == "auto":
        raise UserError(
            "--learner-device is auto; give cpu, cuda:0 or mps, or leave it out to learn beside the physics"
        )
    return resolve_device(name)


def cpu_cores() -> int:
    """Cores that this process may use: its share, where several processes of one training are on the machine.

    Where the system does not say which are free to it (macOS, Windows), all there are.
    """
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity is not None else os.cpu_count() or 1
    return max(1, cores // launcher.place().local_size)


def waits_for_cores() -> dict[str, float]:
    """Time that each thread of this process has been ready to go on but had no core [s], by thread.

    Only Linux tells; elsewhere it is empty.
    """
    waits = {}
    for path in Path("/proc/self/task").glob("*/schedstat"):
        with suppress(OSError, IndexError):  # a thread may end meanwhile
            waits[path.parent.name] = int(path.read_text().split()[1]) / 1e9
    return waits


def reading_is_free(device: torch.device | str) -> bool:
    """Whether a number on a device can be looked at without waiting for the device: on a CPU it can."""
    return torch.device(device).type == "cpu"


def worth_compiling(choice: Compile, device: torch.device) -> bool:
    """Whether to compile on this device."""
    return choice == "on" or (choice == "auto" and device.type == "cuda" and find_spec("triton") is not None)


def compile_methods(owner: object, names: Iterable[str], device: torch.device | str, *, repeated: int = 2) -> None:
    """Make a few kernels of an object's methods; refused where one would wait for the device or leave the graph.

    They always run on one torch thread, as torch compiles anew for another number of them.

    Args:
        owner: Gets compiled methods in the place of its own.
        names: Their names.
        device: Where they run. On a GPU concatenations become one kernel each, whatever is concatenated, as there its
            number counts; on a CPU that computes some of it several times.
        repeated: On a GPU values up to this many times the usual length, or read up to this many times as often, are
            computed wherever they are read, and not by a kernel of their own. Kernels then take longer to compile.
    """
    few: dict[str, Any] = {
        "force_pointwise_cat": True,
        "max_pointwise_cat_inputs": 64,
        "realize_reads_threshold": 4 * repeated,  # 4 and 30 are inductor's own
        "realize_opcount_threshold": 30 * repeated,
    }
    options = None if reading_is_free(device) else few
    for name in names:
        compiled = torch.compile(getattr(owner, name), fullgraph=True, dynamic=False, options=options)
        setattr(owner, name, torch_threads(1)(compiled))


class MadeOnce(Generic[_Arguments, _Result]):
    """A function whose result is kept for each set of arguments: tensors of a device that never change.

    :func:`functools.cache` is one that :func:`torch.compile` looks behind, and makes the result anew in every call.
    """

    def __init__(self, function: Callable[_Arguments, _Result]) -> None:
        self._function = function
        self._made: dict[tuple, _Result] = {}
        self.__doc__ = function.__doc__

    def __call__(self, *arguments: _Arguments.args, **named: _Arguments.kwargs) -> _Result:
        """The result for these arguments, which have no names here: they would not tell results apart."""
        assert not named
        if arguments not in self._made:
            self._made[arguments] = self._function(*arguments, **named)
        return self._made[arguments]


def plain_tensors(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Run a function without gradients but outside of :class:`torch.inference_mode`, wherever it is called from.

    What it keeps can then be changed by whoever calls it next, and is of one kind: torch compiles anew for the other.
    """
    return torch.inference_mode(False)(torch.no_grad()(function))


def finish(device: torch.device | str) -> None:
    """Wait until a device has done its work."""
    if torch.device(device).type == "cuda":
        torch.cuda.synchronize(device)


@contextmanager
def torch_threads(number: int) -> Iterator[None]:
    """Let torch work with so many CPU threads for a while; also a decorator.

    One is right beside the physics: torch's operations on a step are small, and after each of them its idle threads
    spin on the cores that MuJoCo's threads are to use (with them a step took a fifth longer on two cores). Learning
    is faster with all of them.

    Args:
        number: Number of threads.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)
