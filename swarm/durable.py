"""Atomic writing of files: after a crash of the process or the machine, the disk has the whole old or new file."""

import errno
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path

from meanflock.swarm.errors import BadInput, RunFailed

_PATIENCE_S = 5.0  # of a flush


def replace(path: Path, content: bytes | memoryview) -> None:
    """Writes `content` to a temporary file and, once that is on the disk, renames it to `path`."""
    part = _part(path)
    try:
        with part.open("wb", buffering=0) as file:
            write(file, content)
            os.fsync(file.fileno())
        rename(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def put(path: Path, content: bytes | memoryview, remedy: str = "make room and repeat the command") -> Path:
    """Like `replace`, for an output of a command; returns the path.

    Raises:
        RunFailed: the file cannot be written; `remedy` is the advice in the message.
    """
    try:
        replace(path, content)
    except OSError as error:
        raise RunFailed(f"{path}: {error.strerror}; {remedy}") from error
    return path


@contextmanager
def replacing(path: Path) -> Iterator[FileIO]:
    """Context with a new file that replaces `path` at its end, unless an exception (Ctrl-C included) leaves it.

    Raises:
        BadInput: the file cannot be created.
        RunFailed: the disk is full or gone.
    """
    part = _part(path)
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        file = part.open("wb", buffering=0)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; name a file in a folder that can be written") from error
    try:
        with file:
            yield file
            os.fsync(file.fileno())
        rename(part, path)
    except BaseException as error:
        part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise RunFailed(f"{path}: {error.strerror}; make room and repeat the command") from error
        raise


def write(file: FileIO, content: bytes | memoryview) -> None:
    """Writes all of `content`: a single call may write only a part without an error."""
    while content:
        content = content[file.write(content) :]


def move(part: Path, path: Path) -> None:
    """Renames a closed file to `path` once it is on the disk, as `replace` does."""
    with part.open("rb") as file:
        os.fsync(file.fileno())
    rename(part, path)


def rename(part: Path, path: Path) -> None:
    """Renames a file, and waits until the new name is on the disk."""
    os.replace(part, path)
    sync_folder(path.parent)


def remove(path: Path) -> None:
    """Deletes a file and the temporary file of a killed `replace`, durably."""
    _part(path).unlink(missing_ok=True)
    path.unlink(missing_ok=True)
    sync_folder(path.parent)


def _part(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")


def sync_folder(folder: Path) -> None:
    """Waits until the names in a folder are on the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def check_writable(path: Path) -> None:
    """Check, before work begins, that a file can be written.

    Raises:
        BadInput: it cannot be written.
    """
    try:
        path.open("ab").close()
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; give a file in a folder that can be written") from error


def check_folder(folder: Path, flag: str) -> None:
    """Check that files can be written to an existing folder, which was given to `flag`.

    Raises:
        BadInput: no file can be written there.
    """
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise BadInput(f"{flag} {folder}: {error.strerror}; name a folder that can be written") from error


def settle(flush: Callable[[float], None], path: Path | None) -> None:
    """Calls `flush` with a timeout of five seconds, again and again while the file grows, until it succeeds.

    A writer in a thread of its own may die of a full disk without a message. So a file that stops to grow is an error.

    Raises:
        RuntimeError: the last error of `flush`.
    """
    size = -1
    while True:
        try:
            flush(_PATIENCE_S)
            return
        except RuntimeError:
            before, size = size, path.stat().st_size if path is not None and path.exists() else 0
            if size == before:
                raise
