"""Atomic writing of files: after a crash of the process or the machine, the disk has the whole old or new file."""

import errno
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from glob import escape
from io import FileIO
from itertools import count
from pathlib import Path

from meanflock.swarm.errors import BadInput, RunFailed

_PATIENCE_S = 5.0  # of a flush
_REMEDIES = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "make room"),
    errno.EFBIG: "allow larger files",
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "let it be written"),
    **dict.fromkeys((errno.ENOENT, errno.ENOTDIR, errno.ESTALE), "bring back what was deleted or renamed"),
    **dict.fromkeys((errno.EMFILE, errno.ENFILE), "let more files be open"),
    errno.EIO: "check the disk",
}


def replace(path: Path, *parts: bytes | memoryview) -> None:
    """Writes all `parts` to a temporary file and, once that is on the disk, renames it to `path`."""
    part = _part(path)
    try:
        with part.open("wb", buffering=0) as file:
            for content in parts:
                write(file, content)
            os.fsync(file.fileno())
        rename(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def put(path: Path, content: bytes | memoryview, kept: str = "") -> Path:
    """Like `replace`, for an output of a command; returns the path.

    Raises:
        RunFailed: the file cannot be written; `kept` says what is kept.
    """
    try:
        replace(path, content)
    except OSError as error:
        raise not_written(path, error, kept) from error
    return path


def not_written(path: Path, error: OSError, kept: str = "") -> RunFailed:
    """The error of an output of a command that cannot be written; `kept` says what is kept."""
    return RunFailed(f"{path}: {reason(error)}; {kept}{remedy(error)} and repeat the command")


def reason(error: OSError) -> str:
    """What happened to a file, in the words of the system."""
    return error.strerror or (os.strerror(error.errno) if error.errno else str(error))


def remedy(error: OSError) -> str:
    """Advice about a file that cannot be written."""
    return _REMEDIES.get(error.errno or 0, "mend that")


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
            raise not_written(path, error) from error
        raise


def write(file: FileIO, content: bytes | memoryview) -> None:
    """Writes all of `content`: a single call may write only a part without an error."""
    rest = memoryview(content)
    while rest:
        rest = rest[file.write(rest) :]


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
    """Deletes a file and the temporary files of killed calls of `replace`, durably."""
    for part in path.parent.glob(f".{escape(path.name)}.*.part"):
        part.unlink(missing_ok=True)
    path.unlink(missing_ok=True)
    sync_folder(path.parent)


def _part(path: Path) -> Path:
    """A temporary file for `path` that no other writer of `path` uses."""
    return path.with_name(f".{path.name}.{os.urandom(4).hex()}.part")


@contextmanager
def writable(flag: str, folder: Path) -> Iterator[None]:
    """Context for writing to a folder that was given to `flag`.

    Raises:
        BadInput: it cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise BadInput(f"{flag} {folder}: {error.strerror}; name a folder that can be written") from error


@contextmanager
def new_folder(parent: Path, stem: str) -> Iterator[Path]:
    """Context with a new folder in `parent`, called `stem`, or `stem` with a number if that name is taken.

    Processes that ask for the same name at the same time get folders of their own. A folder that is empty at the end is
    removed, and so is `parent` if it was made for it.

    Raises:
        BadInput: no folder can be made there.
    """
    new = not parent.exists()
    with writable("--out", parent):
        folder = _made(parent, stem)
    try:
        yield folder
    finally:
        for left in (folder, *[parent] * new):
            with suppress(OSError):  # it has files, or another run has begun in it
                left.rmdir()


def _made(parent: Path, stem: str) -> Path:
    parent.mkdir(parents=True, exist_ok=True)
    for number in count():
        folder = parent / (f"{stem}-{number}" if number else stem)
        with suppress(FileExistsError):
            folder.mkdir(parents=True)
            return folder
    raise AssertionError("unreachable")


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
    with writable(flag, folder):
        tempfile.TemporaryFile(dir=folder).close()


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
