"""What the router refused. Zenoh drops without a word to anyone but its log, so the log is where the counting is done.

Zenoh writes its log to standard output, from native code. `divert` leaves standard output to Python and sends the rest
to standard error; `Refusals` reads it instead, counts what was refused, and passes on what is new.

The log quotes keys as their senders chose them, line breaks included, so a line of it may be forged. Therefore who was
refused is never taken from a name in the log, but from the number of its session: Zenoh tells it beside the log, and no
client the number of another. A session nobody has met is called unknown. Why a link was refused is one of a few known
reasons. What else is passed on is printable text, on one line, in quotation marks.
"""

import fcntl
import logging
import os
import re
import sys
import threading
from collections import Counter
from contextlib import suppress

from meanflock.swarm.printable import printable

log = logging.getLogger("meanflock.router")

# Refused links are warnings; what the access-control list drops is told at the finest level only.
FILTER = "error,zenoh_link_tls=warn,zenoh::net::routing::interceptor::access_control=trace"

_DRAIN_EVERY_S = 0.1
_PIPE_BYTES = 2**20
_MOST_NAMES = 4096  # remembered; a stranger may invent as many as it likes
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_LINK = re.compile(r"zenoh_link_tls\S*: (?P<why>.*)$")
_WHY = re.compile(
    r"peer sent no certificates|invalid peer certificate: (?:certificate expired|[A-Z]\w{,40})|tls handshake eof"
    r"|received corrupt message of type \w{,40}|received fatal alert: \w{,40}|connection reset|broken pipe",
    re.IGNORECASE,
)
_CACHING = re.compile(r"(?P<thread>ThreadId\(\d+\)).*ACL \(ingress\): caching permissions for `(?P<key>\S+)`")
_DENIED = re.compile(
    r"(?P<thread>ThreadId\(\d+\)).*access_control: (?P<cached>Using cached result: )?(?P<session>\w+)"
    r"(?: on \S+)? is unauthorized to (?P<what>[\w/ ]+) \(ingress\) on (?P<key>\S+)"
)
_STRANGER = re.compile(r"access_control: (?P<session>\w+) did not match any configured ACL subject")
_ERROR = re.compile(r"^(?:\S+ +)?ERROR (?P<text>.*)")


def divert() -> None:
    """From now on what native code prints goes to standard error; `sys.stdout` alone still reaches standard output."""
    if _has_stdout():
        _take_stdout(os.dup(2))


def _has_stdout() -> bool:
    """Whether native output can be taken. Who started this process may have closed standard output: nobody reads it,
    and another file may have its number by now.
    """
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115  # for as long as the process lives
        return sys.stdout.fileno() == 1
    return True


def _take_stdout(instead: int) -> None:
    sys.stdout.flush()
    sys.stdout = os.fdopen(os.dup(1), "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)
    os.dup2(instead, 1)
    os.close(instead)


class Refusals:
    """Counts what the router of this process refused.

    counts: `refused-link` (no certificate, or none of ours, or expired), `denied` (a message or declaration that
        the access-control list does not allow), `backlog` (see `ZenohBus.router`) and `refused-session` (see
        `Links`). A flood can outrun the reader: then the first two are lower bounds.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._seen: Counter[str] = Counter()
        self._names: dict[str, str] = {}  # on the certificates of sessions, by their numbers
        self._counting = threading.Lock()
        self._caching: dict[str, str] = {}
        self._rest = b""
        self._ended: threading.Event | None = None

    def met(self, session: str, name: str) -> None:
        """A session is open, by its number, and the name on its certificate."""
        if len(self._names) >= _MOST_NAMES:  # those that come and go; the oldest is forgotten
            self._names.pop(next(iter(self._names)), None)
        self._names[session] = name

    def listen(self) -> None:
        """From now until `close`, native output of this process is the log that is read, if it has any."""
        if not _has_stdout():  # asked before the pipe is made, which would have its number
            return
        self._source, writing = os.pipe()
        with suppress(OSError, AttributeError):  # not everywhere; the default is large enough for all but floods
            fcntl.fcntl(self._source, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        os.set_blocking(writing, False)  # a full pipe loses lines, and never makes the router wait
        os.set_blocking(self._source, False)
        _take_stdout(writing)
        self._ended = threading.Event()
        self._reader = threading.Thread(target=self._read, args=(self._ended,), daemon=True)
        self._reader.start()

    def close(self) -> None:
        """Reads what is left, says what it came to, and leaves native output to standard error."""
        if self._ended is None:
            return
        os.dup2(2, 1)
        self._ended.set()
        self._reader.join()
        self._drain()
        self._ended = None
        os.close(self._source)
        if self.counts:
            log.warning("refused in all: %s", ", ".join(f"{n} × {what}" for what, n in sorted(self.counts.items())))

    def _read(self, ended: threading.Event) -> None:
        while not ended.wait(_DRAIN_EVERY_S):  # now and then, for a wake-up per line would slow the world
            self._drain()

    def _drain(self) -> None:
        with suppress(BlockingIOError):
            while chunk := os.read(self._source, _PIPE_BYTES):
                self.take(chunk)

    def take(self, chunk: bytes) -> None:
        """The next bytes of the log."""
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        for line in lines:
            if b"is authorized" not in line:
                self._line(_COLOUR.sub("", line.decode(errors="replace")).strip())

    def _line(self, line: str) -> None:
        if caching := _CACHING.search(line):
            self._caching[caching["thread"]] = caching["key"]
        elif denied := _DENIED.search(line):
            # On the first sight of a key Zenoh asks itself all that could be refused; only then is the answer uncached.
            if denied["cached"] or self._caching.get(denied["thread"]) != denied["key"]:
                self.count("denied", f"{self._who(denied['session'])}: {denied['what']} under {denied['key']}")
        elif stranger := _STRANGER.search(line):
            who = self._who(stranger["session"])
            self.count("denied", f"a certificate of our authority of no node of this run, which may do nothing: {who}")
        elif refused := _LINK.search(line):
            why = _WHY.search(refused["why"])
            self.count("refused-link", why[0] if why else "for another reason")
        elif error := _ERROR.search(line):
            self._tell(f"Zenoh's log says {error['text']!r}")

    def _who(self, session: str) -> str:
        return self._names.get(session, "an unknown session")

    def count(self, what: str, text: str) -> None:
        """One more of `what`, from any thread; `text` says which."""
        with self._counting:
            self.counts[what] += 1
        self._tell(f"{what}: {text}", what)

    def _tell(self, text: str, reason: str = "error") -> None:
        """Logs a text the first, second, fourth, eighth … time it comes."""
        text = printable(text)
        with self._counting:
            if text not in self._seen and len(self._seen) >= _MOST_NAMES:
                text = "more, of many kinds"
            self._seen[text] += 1
            times = self._seen[text]
        if times & (times - 1) == 0:
            log.warning("%s%s", text, f" ({times} times)" if times > 1 else "", extra={"reason": reason})
