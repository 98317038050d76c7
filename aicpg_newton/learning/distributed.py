"""Several processes that train one network, each with environments of its own, by torch.distributed.

Everything here does the obvious thing in a process that is alone.
"""

from __future__ import annotations

import datetime
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import torch
import torch.distributed as dist

from aicpg_newton import launcher
from aicpg_newton.device import cpu_cores
from aicpg_newton.errors import UserError

_Result = TypeVar("_Result")

PATIENCE = datetime.timedelta(minutes=10)
"""How long a process waits for another one; the first compilation of all kernels has to fit in it."""


def rank() -> int:
    """Number of this process; 0 is the one that writes."""
    return dist.get_rank() if dist.is_initialized() else 0


def size() -> int:
    """Number of processes that train together."""
    return dist.get_world_size() if dist.is_initialized() else 1


@contextmanager
def joined() -> Iterator[None]:
    """Meet the other processes that a launcher has started, and train with them for as long as this lasts.

    Raises:
        UserError: What the launcher has told is not complete, or the others do not come.
    """
    if launcher.incomplete():
        raise UserError(
            f"{launcher.incomplete()}; start several processes with  torchrun --nproc-per-node=N train.py ...  or unset"
            " WORLD_SIZE to train in this process alone"
        )
    try:
        place = launcher.place()
    except ValueError as error:
        raise UserError(f"{error}; start with torchrun, or unset these variables") from error
    if place.size == 1:
        yield
        return
    # torchrun asks for one thread each; on a CPU that leaves cores idle.
    if os.environ.get("OMP_NUM_THREADS", "1") == "1":
        torch.set_num_threads(cpu_cores())
    backend = "cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo"
    try:
        dist.init_process_group(backend, rank=place.rank, world_size=place.size, timeout=PATIENCE)
    except (RuntimeError, ValueError) as error:
        address = f"{os.environ['MASTER_ADDR']}:{os.environ['MASTER_PORT']}"
        raise UserError(
            f"the {place.size} processes of this training do not find one another at {address}; start all of them"
        ) from error
    try:
        yield
    finally:
        dist.destroy_process_group()


def together(work: Callable[[], _Result]) -> _Result:
    """Do what may be refused; refused in one process, it ends all of them, and only one says why.

    Args:
        work: What every process does.

    Raises:
        UserError: It was refused here, or elsewhere and this is the process that speaks.
        SystemExit: It was refused, and another process says so.
    """
    if size() == 1:
        return work()
    results: list[_Result] = []
    refusal = ""
    try:
        results.append(work())
    except UserError as error:
        refusal = str(error)
    refusals: list[str] = [""] * size()
    dist.all_gather_object(refusals, refusal)
    found = next(filter(None, refusals), None)
    if found is None:
        return results[0]
    if rank() == 0:
        raise UserError(found)
    raise SystemExit(2)


def from_first(work: Callable[[], _Result]) -> _Result:
    """What the first process does, and all get the result of; raises as :func:`together`."""
    if size() == 1:
        return work()
    results: list[Any] = [together(lambda: work() if rank() == 0 else None)]
    dist.broadcast_object_list(results, src=0)
    return results[0]


def greatest(number: int) -> int:
    """The greatest of a number that every process has; none goes on before all have told theirs."""
    if size() == 1:
        return number
    told = torch.tensor(number)  # on the CPU, so that no GPU is waited for
    dist.all_reduce(told, op=dist.ReduceOp.MAX)
    return int(told)


def mean(values: torch.Tensor) -> torch.Tensor:
    """Mean over the processes, the same in each to the last bit."""
    if size() > 1:
        values = values.clone()
        dist.all_reduce(values)
        values /= size()
    return values


def standardised(values: torch.Tensor) -> torch.Tensor:
    """Values minus their mean, over their standard deviation, both over the values of all processes."""
    number = values.numel() * size()
    centred = values - mean(values.mean())
    variance = mean(centred.square().mean()) * number / (number - 1)
    return centred / (variance.sqrt() + 1e-8)


def is_loss(error: RuntimeError) -> bool:
    """Whether an error says that another process has ended, or does not answer any more."""
    return size() > 1 and (isinstance(error, dist.DistError) or "gloo" in str(error).lower())
