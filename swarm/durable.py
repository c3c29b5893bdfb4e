"""Files that are whole after a crash, of the process or the machine: what is on the disk is the old or the new one."""

import errno
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path

from meanflock.swarm.errors import BadInput, RunFailed


def replace(path: Path, content: bytes | memoryview) -> None:
    """Writes `content` beside `path` and puts it in the place of what was there, when it is on the disk."""
    part = _part(path)
    try:
        with part.open("wb", buffering=0) as file:
            write(file, content)
            os.fsync(file.fileno())
        rename(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def put(path: Path, content: bytes | memoryview, mend: str = "make room and repeat the command") -> Path:
    """`replace`, for a command's own file; returns where it is.

    Raises:
        RunFailed: it cannot be written; `mend` says what then.
    """
    try:
        replace(path, content)
    except OSError as error:
        raise RunFailed(f"{path}: {error.strerror}; {mend}") from error
    return path


@contextmanager
def replacing(path: Path) -> Iterator[FileIO]:
    """A new file beside `path`, which takes its place when the context ends without an error, Ctrl-C included.

    Raises:
        BadInput: no file can be made there.
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
    """All of it: a disk that is almost full takes a part without a word."""
    while content:
        content = content[file.write(content) :]


def move(part: Path, path: Path) -> None:
    """Puts a file that others wrote and closed in the place of another, as `replace` does."""
    with part.open("rb") as file:
        os.fsync(file.fileno())
    rename(part, path)


def rename(part: Path, path: Path) -> None:
    """Renames a file that is on the disk, so that the new name is too."""
    os.replace(part, path)
    sync_folder(path.parent)


def remove(path: Path) -> None:
    """Takes a file away, and what a `replace` that was killed left of it, so that it is still gone after a crash."""
    _part(path).unlink(missing_ok=True)
    path.unlink(missing_ok=True)
    sync_folder(path.parent)


def _part(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")


def sync_folder(folder: Path) -> None:
    """Makes sure that the names in a folder are on the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def check_writable(path: Path) -> None:
    """Says that a file cannot be written before somebody works for it.

    Raises:
        BadInput: it cannot.
    """
    try:
        path.open("ab").close()
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; give a file in a folder that can be written") from error


def check_folder(folder: Path, flag: str) -> None:
    """The same of a folder that is there, named with `flag`; nothing is left in it.

    Raises:
        BadInput: no file can be written there.
    """
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise BadInput(f"{flag} {folder}: {error.strerror}; name a folder that can be written") from error


def settle(flush: Callable[[float], None], path: Path | None, patience_s: float = 5.0) -> None:
    """Calls `flush` with so many seconds until all is written, and again while the file grows meanwhile: who writes in
    a thread of its own may have died of a full disk and never tell.

    Raises:
        RuntimeError: what `flush` raised last.
    """
    size = -1
    while True:
        try:
            flush(patience_s)
            return
        except RuntimeError:
            before, size = size, path.stat().st_size if path is not None and path.exists() else 0
            if size == before:
                raise
