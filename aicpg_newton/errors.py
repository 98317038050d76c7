"""The one exception a user is meant to read, and how a command line shows it."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable


class UserError(Exception):
    """Bad input: the message is one sentence that says what is wrong and what to do."""


def run_command(command: Callable[[], object]) -> None:
    """Run a command line; a :class:`UserError` becomes one line on stderr and exit status 2, without a traceback.

    Letters that the terminal does not have are spelled out, as those of a path in another encoding.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        command()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
