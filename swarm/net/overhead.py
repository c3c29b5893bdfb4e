"""What a link sends beside messages: the router keeps it in memory, and Zenoh has no limit on how much.

Fragments of a message that never ends, declarations of keys and interests: a node in good order sends little of them,
and an attacker needs little more, for a fragment of one byte holds a whole buffer. But a link is a socket of this
process, and the kernel counts its bytes. Those no message accounts for are overhead; a link with too much of it is shut
down, and the memory behind it is free again.
"""

import os
import socket
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from meanflock.swarm.net.sockets import address_of, open_sockets, peer_of, received

MESSAGE_BYTES = 48  # around a message, beside its key: headers, sequence number, record of TLS
FRAGMENT_BYTES, PER_FRAGMENT = 4000, 32  # a long message comes in pieces of about so much, each with headers
ANSWERS = 64  # at the most that one may still owe
ALLOWED_BYTES = 2**14  # handshake, certificates, declarations and more
PER_SECOND_BYTES = 256.0  # signs of life
LOOK_S = 0.05  # how often the memory of this process is looked at …
GROWN_BYTES = 2**20  # … and after how much more of it, or after how long, the links are
LOOK_AT_LEAST_S = 1.0


def accounted(size: int, around: int) -> int:
    """Bytes on a link that a message of `size` bytes explains, with so many around it."""
    return size + around + PER_FRAGMENT * (size // FRAGMENT_BYTES)


class _Link:
    """A link whose bytes are counted."""

    def __init__(self, name: str, before: int) -> None:
        self.name, self.before = name, before  # what its name's messages explained when it was opened
        self.since_s = time.monotonic()
        self.number: int | None = None  # of its file


class Overhead(threading.Thread):
    """Looks now and then at what each link sent, and names those that sent too much beside messages."""

    def __init__(self, largest: int, too_much: Callable[[str, str], None]) -> None:
        """`largest`: bytes of the longest message, which may be under way. `too_much`: is told the name on the
        certificate of a link, and where its other end is.
        """
        super().__init__(name="overhead", daemon=True)
        self._allowed, self._too_much = ALLOWED_BYTES + largest, too_much
        self._links: dict[str, _Link] = {}  # by locator
        self._explained: defaultdict[str, int] = defaultdict(int)  # bytes, by the name on the certificate
        self._asked: defaultdict[str, int] = defaultdict(int)  # messages it was sent and has not answered
        self._lock = threading.Lock()
        self._cut: set[str] = set()  # links that are shut down and not gone yet
        self._freed = False
        self._ended = threading.Event()

    def opened(self, name: str, locator: str) -> None:
        """A link is there."""
        with self._lock:
            self._links[locator] = _Link(name, self._explained[name])

    def closed(self, locator: str) -> None:
        """A link is gone."""
        with self._lock:
            self._links.pop(locator, None)
            if locator in self._cut:  # and what it held is free
                self._cut.remove(locator)
                self._freed = True

    def asked(self, name: str) -> None:
        """A message went to whom that name belongs to, who may answer."""
        with self._lock:
            self._asked[name] = min(self._asked[name] + 1, ANSWERS)

    def explained(self, name: str, key: str, size: int) -> None:
        """A message of so many bytes has come from whom that name belongs to. What is around it is explained as well if
        it is an answer, for of short messages nobody asked for one may send as many as one likes.
        """
        with self._lock:
            answers = self._asked[name] > 0
            self._asked[name] -= answers
            self._explained[name] += accounted(size, len(key) + MESSAGE_BYTES if answers else 0)

    def run(self) -> None:
        """Until `close`."""
        before, looked = resident(), time.monotonic()
        while not self._ended.wait(LOOK_S):
            if self._freed:
                self._freed = False
                give_back()
            now = resident()
            if now - before >= GROWN_BYTES or time.monotonic() - looked >= LOOK_AT_LEAST_S:
                self.look()
                looked = time.monotonic()
                before = now

    def look(self) -> list[str]:
        """Where the other ends are of links that sent too much; each is told."""
        with self._lock:
            links, explained = dict(self._links), dict(self._explained)
        unknown = {address_of(locator): link for locator, link in links.items() if link.number is None}
        if unknown:
            for number, found in open_sockets():
                peer = peer_of(found)
                if peer is not None and peer in unknown:
                    unknown[peer].number = number
        over = []
        for locator, link in links.items():
            with suppress(OSError), _socket(link, locator) as found:
                allowed = self._allowed + PER_SECOND_BYTES * (time.monotonic() - link.since_s)
                if received(found) - (explained[link.name] - link.before) > allowed:
                    over.append(locator)
        for locator in over:
            with self._lock:
                self._cut.add(locator)
            self._too_much(links[locator].name, locator)
        return over

    def close(self) -> None:
        """Looks no more."""
        self._ended.set()
        if self.is_alive():
            self.join()


@contextmanager
def _socket(link: _Link, locator: str) -> Iterator[socket.socket]:
    """The socket of a link, as long as its file is still that."""
    if link.number is None:
        raise OSError(locator)
    found = socket.socket(fileno=link.number)
    try:
        if peer_of(found) != address_of(locator):
            link.number = None
            raise OSError(locator)
        yield found
    finally:
        found.detach()


def resident() -> int:
    """Bytes of memory this process holds now; 0 where that is not known."""
    with suppress(OSError), open("/proc/self/statm", "rb") as statm:
        return int(statm.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return 0


def give_back() -> None:
    """Returns memory that was freed to the system, where the C library keeps it and can be asked."""
    import ctypes  # here: agents keep it out of their memory

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
