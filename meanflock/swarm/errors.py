"""Exceptions with their exit codes, printable text of foreign errors, and the exit of a process that lacks a library.

This module imports the standard library only, so it can report any other library that is missing.
"""

import sys
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

EXIT_DONE = 0
EXIT_RUN_FAILED = 1
EXIT_BAD_INPUT = 2
_SIMILAR = 0.7  # least share of common letters of two names that are similar
_LONGEST_REASON = 2000  # characters of the error of a plug-in: PyTorch names all layers that do not fit
_LONGEST_TEXT = 300  # characters; a key expression of Zenoh may have thousands
LEAN = frozenset({"click", "psutil", "pyarrow", "rich", "tomli_w"})  # libraries of the extra `fly`
PLUGIN_MODULE = "meanflock_plugin_"  # prefix of the names of modules loaded from files
FAILURES = (Exception, SystemExit)  # a plug-in may raise these; Ctrl-C comes from the user
_OURS = {"meanflock", "numpy", "click", *sys.stdlib_module_names}  # frames ignored when locating an error


class MeanflockError(Exception):
    """Base class of the errors that meanflock raises. `exit_code` is the exit code of the process."""

    exit_code = EXIT_RUN_FAILED


class BadInput(MeanflockError):
    """A file, flag or variable that cannot be used; the message says what, where and how to fix it."""

    exit_code = EXIT_BAD_INPUT


class RunFailed(MeanflockError):
    """A run that began and could not be finished."""


class ProcessDied(RunFailed):
    """A process died that a run needs."""


class PluginFailed(RunFailed):
    """A plug-in failed without which no flight goes on: vehicle, channel or coding."""


class BusError(RunFailed):
    """The bus could not be opened, or the swarm could not be joined."""


class WorldGone(BusError):
    """The session with the world ended without a Stop: the world or the connection is gone."""


class Refused(BusError):
    """The world answered that a node cannot take part; `over`: the flight is over, or never needs such a node."""

    def __init__(self, text: str, over: bool = False) -> None:
        super().__init__(text)
        self.over = over


class MessageRejected(MeanflockError):
    """Bytes from the network that are not a message of this run; `reason` is the name it is counted under.

    Reasons: `malformed`, `oversized`, `wrong-kind`, `wrong-shape`, `non-finite`, `wrong-run`, `stale`,
    `duplicate`, `unknown-node`, `wrong-name`, `wrong-round`, `wrong-key`; of MAVLink
    also `unknown-system`, `wrong-frame`, `wrong-mask`. The detail may quote what came: it is shown
    as printable text.
    """

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {printable(detail)}")
        self.reason = reason


def most_similar(word: str, names: Iterable[str]) -> str | None:
    """The most similar of some names in any case, or one with the same letters; None if none is similar."""
    from difflib import get_close_matches  # only here: no agent needs it

    lower, word = {name.lower(): name for name in names}, word.lower()
    same = [name for name in lower if sorted(name) == sorted(word)]
    found = next(iter([*get_close_matches(word, lower, 1, _SIMILAR), *same]), None)
    return lower[found] if found else None


def meant(word: str, names: Iterable[str]) -> str:
    """The most similar of some names as part of an error: `; did you mean 'hjb'?`; empty if none is similar."""
    name = most_similar(word, names)
    return f"; did you mean {name!r}?" if name else ""


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
    """Text of several lines, each as by `printable`, but not cut off."""
    return "\n".join(printable(line, len(line)) for line in text.split("\n"))


@contextmanager
def available(by: str, extra: str = "") -> Iterator[None]:
    """Context that uses libraries in a process that goes on: `by` needs them, and our extra `extra` installs them.

    Raises:
        BadInput: a library is not installed; the message says which one, and what to install.
    """
    try:
        yield
    except ModuleNotFoundError as missing:
        if not (message := lacking(missing, by, extra)):
            raise
        raise BadInput(message) from missing


@contextmanager
def needed(by: str, extra: str = "") -> Iterator[None]:
    """Context that imports libraries: `by` needs them, and our extra `extra` installs them.

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
        if not (message := lacking(missing, by, extra)):
            raise
        print(f"error: {message}", file=sys.stderr)
        raise SystemExit(EXIT_BAD_INPUT) from None


def lacking(error: BaseException, by: str, extra: str = "") -> str:
    """Advice what to install, if `error` is the lack of a library that `by` needs; else an empty text.

    A library of the lean extra `fly` is advised with that extra, although `ground` has it too.
    """
    library = ((isinstance(error, ModuleNotFoundError) and error.name) or "").partition(".")[0]
    if library in ("meanflock", "") or _is_there(library):
        return ""
    package, more = f"'meanflock[{extra}]'" if extra else "meanflock", ""
    if extra == "ground" and library in LEAN:
        package, more = "'meanflock[fly]'", ", or 'meanflock[ground]' with recordings, plots and comparisons"
    return f"{library} is not installed, and {by} needs it: pip install {package}{more}"


def _is_there(library: str) -> bool:
    """Returns whether the library is installed. If so, it has a defect, and installing an extra does not help."""
    try:
        return find_spec(library) is not None
    except ValueError:
        return False


def last_line(error: BaseException) -> str:
    """The error, and the line of the plug-in in which it arose, if any."""
    if isinstance(error, BadInput):  # it says where
        return str(error)
    if isinstance(error, SyntaxError) and error.filename:  # raised by the compiler
        return f"{reason(error)} ({Path(error.filename).name}, line {error.lineno})"
    place = plugin_line(error)
    return reason(error) if place is None else f"{reason(error)} ({Path(place[0]).name}, line {place[1]})"


def plugin_line(error: BaseException) -> tuple[str, int] | None:
    """File and line of the plug-in in which an error arose; None: it arose in meanflock, which refused an answer."""
    places = [  # top-level module, file and line, the innermost last
        (str(frame.f_globals.get("__name__")).partition(".")[0], frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
    ]
    theirs = [place for place in places if place[0] not in _OURS]
    own = [place for place in theirs if place[0] == theirs[0][0]]  # without the libraries that it calls
    return own[-1][1:] if own else None


def reason(error: BaseException) -> str:
    """The error in one line, without its notes; a longer one is cut off and ends in "…"."""
    trace = traceback.TracebackException(type(error), error, None)
    trace.__notes__ = []  # the notes would be the last lines
    *_, last = trace.format_exception_only()
    if type(error).__module__.startswith(PLUGIN_MODULE):  # the name that the loader gave the module
        last = last.removeprefix(f"{type(error).__module__}.")
    line = " ".join(filter(None, map(str.strip, last.splitlines())))
    return line[:_LONGEST_REASON] + "…" * (len(line) > _LONGEST_REASON)
