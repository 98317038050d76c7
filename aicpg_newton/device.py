"""Which device to run on, and on how many CPU threads torch works there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from aicpg_newton.errors import UserError


def resolve_device(name: str) -> torch.device:
    """Torch device of a name; ``auto`` is the first GPU, or the CPU with a line that says so.

    Args:
        name: ``auto``, ``cpu``, ``cuda`` or ``cuda:N``.

    Raises:
        UserError: The name is unknown, or names a GPU that is not there.
    """
    if name == "auto":
        if torch.cuda.is_available():
            return torch.device("cuda:0")
        print("No CUDA device found: running on the CPU.")
        return torch.device("cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise UserError(f"unknown device {name!r}; choose auto, cpu or cuda:0") from error
    if device.type == "cpu":
        return torch.device("cpu")
    if device.type != "cuda":
        raise UserError(f"device {name!r} is not supported; choose auto, cpu or cuda:0")
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if (device.index or 0) >= count:
        raise UserError(f"device {name!r} is not there (CUDA devices found: {count}); use --device cpu")
    return torch.device("cuda", device.index or 0)


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
