"""The one exception a user is meant to read, and how a command line shows it."""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Callable, Iterable

from aicpg_newton import console, launcher

_PLACES = {
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EROFS,
    errno.EACCES,
    errno.EPERM,
    errno.ENAMETOOLONG,
    errno.EIO,
}
"""Faults of a disk or a folder, not of this package."""


class UserError(Exception):
    """Bad input: the message is one sentence that says what is wrong and what to do."""


def _refuse_other_encodings(words: Iterable[str]) -> None:
    """Refuse options with bytes that are not UTF-8, before anything is made: libraries take no such paths.

    Raises:
        UserError: There are such bytes.
    """
    for word in words:
        try:
            os.fsencode(word).decode("utf-8")
        except UnicodeError as error:
            raise UserError(
                f"{os.fsencode(word)!r} holds bytes that are not UTF-8; rename the file or the folder, or change into"
                " the folder and give a path from there"
            ) from error


def run_command(command: Callable[[], object], *, alone: bool = True) -> None:
    """Run a command line; a :class:`UserError` becomes one line on stderr and exit status 2, without a traceback.

    Letters that the terminal does not have are spelled out, as those of a path in another encoding. The command
    continues when its output pipe or terminal is closed.

    Args:
        command: What is to be done.
        alone: Refuse to be one of several processes of a launcher, each of which would do the same.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    if not {"-h", "--help"} & set(sys.argv):  # a closed pipe (`| head`) ends the help
        console.outlive_readers()
    who = ""
    try:
        try:
            place = launcher.place()
        except ValueError as error:
            raise UserError(f"{error}; start with torchrun, or unset these variables") from error
        who = f"process {place.rank}: " if place.rank else ""
        if alone and place.size > 1:
            raise UserError("this command is for one process, only train.py is for several; start it without torchrun")
        _refuse_other_encodings(sys.argv[1:])
        command()
    except UserError as error:
        print(f"{who}error: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # whoever read the output has gone
        sys.exit(1)
    except OSError as error:
        if error.errno not in _PLACES:
            raise
        where = f" {error.filename}" if error.filename else ""
        kernels = getattr(getattr(sys.modules.get("warp"), "config", None), "kernel_cache_dir", None)
        advice = "make room or choose another"
        if kernels and str(error.filename).startswith(kernels):
            advice = "set WARP_CACHE_PATH to a folder for compiled kernels that can be written to"
        print(f"error: cannot write or read{where} ({error.strerror}); {advice}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        if not who:
            print("interrupted", file=sys.stderr)
        sys.exit(130)
