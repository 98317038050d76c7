"""Standard streams whose reader may end: a long command continues without them."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any

_GONE = {errno.EPIPE, errno.EIO}
"""The reader of a pipe has ended, or the terminal has been closed."""


class _Outlet(io.RawIOBase):
    """A standard stream redirected to the null device once its reader has ended, with a line on stderr."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._descriptor

    def isatty(self) -> bool:
        return os.isatty(self._descriptor)

    def write(self, data: Any, /) -> int:
        try:
            return os.write(self._descriptor, data)
        except OSError as error:
            if error.errno not in _GONE:
                raise
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._descriptor)  # programs that are started from here inherit it
        os.close(nowhere)
        if self._descriptor != 2:
            print("The reader of the output has ended; continuing without console output.", file=sys.stderr, flush=True)
        return memoryview(data).nbytes


def outlive_readers() -> None:
    """Let stdout and stderr go silent, in place of ending the work, when their readers go away.

    What is no stream of this process's own, as where tests capture the output, stays as it is; so do the consoles of
    Windows, which take no bytes.
    """
    for name in ("stdout", "stderr") if os.name != "nt" else ():
        stream = getattr(sys, name)
        if not isinstance(stream, io.TextIOWrapper) or stream is not getattr(sys, f"__{name}__"):
            continue
        stream.flush()
        lasting = io.TextIOWrapper(
            io.BufferedWriter(_Outlet(stream.fileno())),
            encoding=stream.encoding,
            errors=stream.errors,
            line_buffering=stream.line_buffering or stream.write_through or name == "stderr",
        )
        setattr(sys, name, lasting)
