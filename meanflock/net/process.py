"""Start and end of a process: flags that are also variables, signals, the launcher, restarts, exit codes."""

import argparse
import logging
import math
import os
import select
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING, NoReturn, Self

from meanflock.net.access import DEFAULT_ENDPOINT, Identity
from meanflock.swarm import logs, paths, plugins
from meanflock.swarm.ending import end
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED, BadInput, MeanflockError

if TYPE_CHECKING:
    import subprocess

_OVERDUE_S = 1.0  # after the first signal
_GRACE_S = 10.0  # for processes that notice the end of their launcher themselves
QUICK_S = 10.0  # a process that dies sooner has died quickly
TERM_GRACE_S = 5.0  # between SIGTERM and SIGKILL
AT_MOST = 5  # number of quick deaths in a row after which a process is still started again
CHILD = "MEANFLOCK_CHILD"  # variable, "1" in a process whose launcher holds its standard input open
READY = "MEANFLOCK_READY"  # variable: the descriptor on which a process tells its launcher that others can join


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        print(f"error: {message}; see {self.prog} --help", file=sys.stderr)
        raise SystemExit(EXIT_BAD_INPUT)


def parser(module: str, description: str, example: str) -> argparse.ArgumentParser:
    """A parser with the flags every process has; each is also a variable MEANFLOCK_<FLAG>.

    Raises:
        BadInput: a file of plug-ins cannot be used.
    """
    result = _Parser(
        prog=f"python -m meanflock.{module}",
        description=description,
        epilog=f"example: {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    flag(result, "--endpoint", DEFAULT_ENDPOINT, "where the world listens", metavar="ADDRESS")
    flag(result, "--run", "swarm", "name of the run; nodes of other runs never meet", metavar="NAME")
    flag(result, "--tls", "", "folder of certificates; every link is then mutual TLS", metavar="DIR")
    flag(result, "--wait", "60", "how long to wait for the other processes", seconds("--wait"), "SECONDS")
    help_text = f"a file with plug-ins, repeatable (${plugins.FILES}: several, as PATH separates them)"
    result.add_argument("--plugin", action="append", metavar="FILE.py", type=plugins.load_file, help=help_text)
    plugins.load_files(filter(None, os.environ.get(plugins.FILES, "").split(os.pathsep)))
    flag(result, "--log-format", logs.TEXT, "text, or json for one object per line", logs.check, "FORMAT")
    return result


def flag(
    to: argparse.ArgumentParser,
    name: str,
    default: str,
    description: str,
    type_: Callable[[str], object] = str,
    metavar: str | None = None,
) -> None:
    """Adds a flag whose default is the variable of its name, if that is set."""
    variable = "MEANFLOCK_" + name.strip("-").upper().replace("-", "_")
    text = f"{description} (${variable}, default {default or 'none'})"
    to.add_argument(name, default=os.environ.get(variable, default), type=type_, help=text, metavar=metavar)


def seconds(name: str, least: float = 0.0) -> Callable[[str], float]:
    """Returns a parser of the flag `name`: a finite time in seconds, at least `least`."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value < math.inf:
            raise BadInput(f"{name} {text}: seconds, at least {least:g}, for example {name} 30")
        return value

    return read


def identity(tls: str, name: str) -> Identity | None:
    """Identity of this process if `--tls` was given, else None."""
    return Identity(paths.given(tls), name) if tls else None


class Interrupted:
    """True after SIGINT or SIGTERM. The first signal only sets it; the second ends the process at once.

    As a context manager it restores the previous signal handlers.
    """

    def __init__(self) -> None:
        self.at_once: Callable[[], str] | None = None  # called before an immediate end; returns the error text
        self.overdue = ""  # shown if the process goes on for long after the first signal
        self._timer: threading.Timer | None = None
        self._interrupted = False
        self._before = {number: signal.signal(number, self._note) for number in (signal.SIGINT, signal.SIGTERM)}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._timer is not None:
            self._timer.cancel()
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def __bool__(self) -> bool:
        return self._interrupted

    def _note(self, number: int, _frame: object) -> None:
        if not self._interrupted:
            self._interrupted = True
            if self.overdue:
                self._timer = threading.Timer(_OVERDUE_S, logs.show, (self.overdue, logging.WARNING))
                self._timer.daemon = True
                self._timer.start()
            return
        if self.at_once is not None:
            with suppress(Exception):  # the process may be in any state
                logs.show(f"error: {self.at_once()}", logging.ERROR)
            os._exit(EXIT_RUN_FAILED)
        os._exit(128 + number)  # also as process 1 of a container, where the default action is ignored


def ready() -> None:
    """Tell the launcher, if it asked, that others can join."""
    if (number := os.environ.pop(READY, "")).isdigit():
        with suppress(OSError):  # nobody waits any more
            os.write(int(number), b".")
        with suppress(OSError):
            os.close(int(number))


def launched() -> bool:
    """Returns whether this process was started by a launcher, which holds its standard input open."""
    return os.environ.get(CHILD) == "1"


def orphaned() -> bool:
    """Returns whether this process was started by a launcher that is gone."""
    if not launched():
        return False
    readable, _, _ = select.select([0], [], [], 0)
    return bool(readable) and os.read(0, 1) == b""


def end_with_launcher() -> None:
    """Start a thread that ends this process soon after its launcher is gone, even if a plug-in hangs."""
    if launched():
        threading.Thread(target=_end_with_launcher, daemon=True).start()


def _end_with_launcher() -> None:
    while not orphaned():
        select.select([0], [], [])  # readable once the other end is closed, because nothing is written to it
    time.sleep(_GRACE_S)
    os._exit(EXIT_RUN_FAILED)


class Restarts:
    """Limits how often a process that dies right after its start is started again. Each process has a name."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._since: dict[Hashable, float] = {}
        self._quick: Counter[Hashable] = Counter()

    def started(self, name: Hashable) -> None:
        """Notes the start of a process."""
        self._since[name] = self._clock()

    def again(self, name: Hashable) -> bool:
        """Returns whether a process that has died should be started again."""
        if self._clock() - self._since[name] >= QUICK_S:
            self._quick[name] = 0
        self._quick[name] += 1
        return self._quick[name] <= AT_MOST


def how_it_ended(code: int) -> str:
    """The exit code of a process, or minus the signal that killed it, in words."""
    if code == -signal.SIGKILL:
        return "was killed by SIGKILL, as the system does with a process that takes too much memory"
    return f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"


def end_all(processes: Sequence["subprocess.Popen[bytes]"]) -> None:
    """Ends the processes that still run: SIGTERM, then SIGKILL for those that outlive `TERM_GRACE_S`."""
    from subprocess import TimeoutExpired  # only here: agents and leaders start no processes

    running = [process for process in processes if process.poll() is None]
    for process in running:
        process.terminate()
        process.send_signal(signal.SIGCONT)  # a stopped process handles no signal
    end = time.monotonic() + TERM_GRACE_S
    for process in running:
        try:
            process.wait(max(0.0, end - time.monotonic()))
        except TimeoutExpired:
            process.kill()
            process.wait()


@contextmanager
def _closed_input() -> Iterator[None]:
    """Context in which a plug-in that reads standard input, as `breakpoint` does, is at its end at once; nobody writes
    to it, so the plug-in would wait until its node is lost."""
    with open(os.devnull, encoding="utf-8") as nothing:
        sys.stdin = nothing
        yield


def main(body: Callable[[], None]) -> NoReturn:
    """Runs a process: its errors become one line and their exit code."""
    code = EXIT_RUN_FAILED
    try:
        logs.start(os.environ.get("MEANFLOCK_LOG_FORMAT") or logs.TEXT)  # until `body` starts its own
        with _closed_input() if launched() else nullcontext():
            body()
    except MeanflockError as error:
        logs.show(f"error: {error}", logging.ERROR)
        code = error.exit_code
    except KeyboardInterrupt:
        pass
    except Exception:
        logging.getLogger("meanflock").exception("a defect of meanflock, not of its input")
    else:
        code = EXIT_DONE
    end(code)
