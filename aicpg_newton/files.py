"""Files that appear whole or not at all, and work that only one process does."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from aicpg_newton.errors import UserError


class WholeFile:
    """A file that is written under another name beside its own, and takes its own when it is complete.

    A context manager: an exception within leaves the file as it was. It is on the disk when it gets its name, so a
    machine that stops then holds the old file or the new one.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.temporary = path.with_name(path.name + ".partial")
        """What is to be written to."""

    def keep(self) -> None:
        """Give the file its name.

        Raises:
            UserError: The disk does not take it.
        """
        try:
            _to_disk(self.temporary)
            os.replace(self.temporary, self.path)
            _names_to_disk(self.path.parent)
        except OSError as error:
            self.drop()
            raise self._sorry(error) from error

    def drop(self) -> None:
        """Remove what was written."""
        self.temporary.unlink(missing_ok=True)

    def _sorry(self, error: OSError) -> UserError:
        return UserError(f"cannot write {self.path} ({error.strerror or error}); make room or choose another place")

    def __enter__(self) -> Path:
        return self.temporary

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.keep()
            return
        self.drop()
        if isinstance(error, OSError):
            raise self._sorry(error) from error


@contextmanager
def only_one(path: Path) -> Iterator[bool]:
    """Whether this process alone does what a file stands for, for as long as it lasts; the others are told False.

    The system takes the lock back when a process ends, however it ends. Where it has no such locks (Windows), everyone
    is told True, and so they are on a disk that has none.

    Args:
        path: File that is locked; it is made, and stays behind empty.

    Raises:
        UserError: The file cannot be made.
    """
    try:
        import fcntl
    except ImportError:
        yield True
        return
    try:
        file = path.open("w", encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write into {path.parent} ({error.strerror}); choose another folder") from error
    with file:
        alone = True
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            alone = False
        except OSError:
            pass
        yield alone


def write_text(path: Path, text: str) -> None:
    """Write a text file.

    Raises:
        UserError: The disk does not take it.
    """
    with WholeFile(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def make_folder(folder: Path) -> None:
    """Make a folder to write into, unless it is there.

    Raises:
        UserError: It cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the folder {folder} ({error.strerror}); choose another place") from error
    if not os.access(folder, os.W_OK):
        raise UserError(f"the folder {folder} may not be written to; choose another place")


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder that is gone afterwards.

    Raises:
        UserError: The system's temporary folder does not take what is written into it.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            yield Path(folder)
    except OSError as error:
        place = os.environ.get("TMPDIR", "the temporary folder")
        raise UserError(
            f"cannot write into {place} ({error.strerror or error}); make room there, or set TMPDIR to another folder"
        ) from error


def _to_disk(path: Path) -> None:
    """Wait until a file's content is on the disk."""
    with path.open("rb+") as file:  # Windows waits for files that are open for writing alone
        os.fsync(file.fileno())


def _names_to_disk(folder: Path) -> None:
    """Wait until the names in a folder are on the disk, where the system can open folders (Windows cannot)."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
