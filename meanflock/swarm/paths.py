"""The rule for paths that users give, and reading of files that others may have written."""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path
from typing import Any

from meanflock.swarm.errors import BadInput, printable

RECORD_BYTES = 2**26  # most bytes of a scenario, a summary or a result
LOG_BYTES = 2**30  # most bytes of a file of events or a job
CHECKPOINT_BYTES = 2**34  # most bytes of a checkpoint


def given(path: "str | os.PathLike[str]") -> Path:
    """The path that a user gave, with the home folder in place of `~`. Every path of a user goes through here.

    Raises:
        BadInput: it is no path, there is no such home folder, it is not UTF-8, as some libraries need, or contains NUL.
    """
    try:
        text: Any = os.fspath(path)
    except TypeError:
        text = None
    if not isinstance(text, str):
        raise BadInput(f"{path!r} is no path of a file; give a text or a Path")
    shown = printable(text)
    found = Path(os.path.expanduser(text))
    if text.startswith("~") and found == Path(text):
        raise BadInput(f"{shown}: there is no such home folder; write the whole path, or ./{shown}")
    try:
        whole = str(found.absolute())
    except OSError as error:
        raise BadInput(f"{shown}: the working folder is gone; go to another one") from error
    if "\0" in whole:
        raise BadInput(f"{shown}: no path contains NUL; take another name")
    try:
        whole.encode()
    except UnicodeEncodeError as error:
        raise BadInput(f"{printable(whole)}: the path is not UTF-8; take or make a folder whose name is") from error
    return Path(whole) if str(found).startswith("~") else found  # ./~ is a name, here and when it is read again


def opened(path: Path) -> BufferedReader:
    """A regular file, open for reading. Raises OSError for anything else: a pipe would block, a device never end."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "not a regular file")
    return os.fdopen(descriptor, "rb")


def read(path: Path, most: int = RECORD_BYTES) -> bytes:
    """The content of a regular file of at most `most` bytes. Raises OSError."""
    with opened(path) as file:
        if os.fstat(file.fileno()).st_size > most:
            raise _too_large(most)
        return file.read(most)


def read_stream(path: Path, most: int = RECORD_BYTES) -> bytes:
    """The content of a file that may be a pipe, such as `/dev/stdin`. Raises OSError."""
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise _too_large(most)
    return content


def _too_large(most: int) -> OSError:
    return OSError(errno.EFBIG, f"larger than {most} bytes")
