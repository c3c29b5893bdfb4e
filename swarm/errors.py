"""The exception tree with exit codes, text from outside made printable, and the end of a process that lacks a library.

Imports nothing that could be missing itself.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

EXIT_DONE = 0
EXIT_RUN_FAILED = 1
EXIT_BAD_INPUT = 2
_LONGEST_TEXT = 300  # characters; a key expression of Zenoh may have thousands


class MeanflockError(Exception):
    """Base class of the errors that meanflock raises. `exit_code` is the exit code of the process."""

    exit_code = EXIT_RUN_FAILED


class BadInput(MeanflockError):
    """A file, flag or variable that cannot be used; the message says what, where and how to mend it."""

    exit_code = EXIT_BAD_INPUT


class RunFailed(MeanflockError):
    """A run that began and could not be finished."""


class BusError(RunFailed):
    """The bus could not be opened, or the swarm could not be joined."""


class WorldGone(BusError):
    """The session with the world ended without a word: the world is gone, or the way to it."""


class Refused(BusError):
    """The world answered that a node cannot take part; `over`: because the flight is over."""

    def __init__(self, text: str, over: bool = False) -> None:
        super().__init__(text)
        self.over = over


class MessageRejected(MeanflockError):
    """Bytes from the network that are not a message of this run; `reason` is the name it is counted under.

    Reasons: `malformed`, `oversized`, `wrong-kind`, `wrong-shape`, `non-finite`, `wrong-run`, `stale`,
    `duplicate`, `unknown-node`, `wrong-name`, `wrong-round`, `wrong-key`. The detail may quote what came: it is shown
    as printable text.
    """

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {printable(detail)}")
        self.reason = reason


def printable(text: str, most: int = _LONGEST_TEXT) -> str:
    """Text from outside on one line, with every character that is not printable as a backslash escape.

    Line breaks, ESC and direction marks are escaped, so the text cannot steer a terminal. Text of more than `most`
    characters is cut off and ends in "…". Harmless text is returned as it is.
    """
    shown = text[:most]
    if not shown.isprintable():
        shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in shown)
    return shown + "…" * (len(text) > most)


def printable_lines(text: str) -> str:
    """The same for text of several lines, which are not cut off."""
    return "\n".join(printable(line, len(line)) for line in text.split("\n"))


@contextmanager
def needed(by: str, extra: str = "") -> Iterator[None]:
    """Context that imports libraries: they are needed `by` somebody, and come with `extra` of ours.

    Raises:
        SystemExit: a library is not installed, and a line on stderr says which one, and what to install; or Ctrl-C was
            pressed.
    """
    try:
        yield
    except KeyboardInterrupt:
        print("error: interrupted", file=sys.stderr)
        raise SystemExit(EXIT_RUN_FAILED) from None
    except ModuleNotFoundError as missing:
        if not (what := lacking(missing, by, extra)):
            raise
        print(f"error: {what}", file=sys.stderr)
        raise SystemExit(EXIT_BAD_INPUT) from None


def lacking(error: BaseException, by: str, extra: str = "") -> str:
    """What to install if `error` is the lack of a library that is needed `by` somebody; else nothing."""
    library = ((isinstance(error, ModuleNotFoundError) and error.name) or "").partition(".")[0]
    if library in ("meanflock", "") or _is_there(library):
        return ""
    package = f"'meanflock[{extra}]'" if extra else "meanflock"
    return f"{library} is not installed, and {by} needs it: pip install {package}"


def _is_there(library: str) -> bool:
    """Whether the library is installed: then a part of it is missing, which is a defect and no matter of extras."""
    try:
        return find_spec(library) is not None
    except ValueError:
        return False
