"""The links of the router: whose certificate opened each, and no more of one certificate than its holder needs.

Zenoh limits the sessions of a router, not those of a certificate, nor what comes over one beside messages, and has no
call that ends one. But a link is a socket of this process, so one too many, or one with too much, is shut down, as if
its other end had gone.

What a link sends beside messages the router keeps in memory: fragments of a message that never ends, declarations of
keys and interests. A node in good order sends little of them, and an attacker needs little more, for a fragment of one
byte holds a whole buffer. The kernel counts the bytes of a socket; those no message accounts for are overhead, and when
a link with too much of it is shut down, the memory behind it is free again.
"""

import os
import socket
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from meanflock.swarm.net.refusals import Refusals
from meanflock.swarm.net.sockets import address_of, can_count, open_sockets, peer_of, received, shut_down

MESSAGE_BYTES = 48  # around a message, beside its key: headers, sequence number, record of TLS
FRAGMENT_BYTES, PER_FRAGMENT = 4000, 32  # a long message comes in pieces of about so much, each with headers
ANSWERS = 64  # at the most that one may still owe
ALLOWED_BYTES = 2**14  # handshake, certificates, declarations and more
PER_SECOND_BYTES = 256.0  # signs of life
LOOK_S = 0.05  # how often the memory of this process is looked at …
GROWN_BYTES = 2**20  # … and after how much more of it, or after how long, the links are
LOOK_AT_LEAST_S = 1.0


class _Link:
    """A link whose bytes are counted."""

    def __init__(self, name: str, before: int) -> None:
        self.name, self.before = name, before  # what its name's messages explained when it was opened
        self.since_s = time.monotonic()
        self.number: int | None = None  # of its file


class Links(threading.Thread):
    """Knows links by the name on the certificate, and shuts down those beyond what the name may have or send.

    What is sent is looked at now and then from `start` on, where this system counts the bytes of a socket.
    """

    def __init__(self, at_most: Callable[[str], int], largest: int, refusals: Refusals) -> None:
        """`at_most`: how many links a name may have at once. `largest`: bytes of the longest message, which may be
        under way. `refusals`: where what is shut down is counted as `refused-session`, and what knows sessions by the
        name on their certificate.
        """
        super().__init__(name="links", daemon=True)
        self._at_most, self._allowed, self._refusals = at_most, ALLOWED_BYTES + largest, refusals
        self._links: dict[str, _Link] = {}  # by locator of the other end
        self._explained: defaultdict[str, int] = defaultdict(int)  # bytes, by the name on the certificate
        self._asked: defaultdict[str, int] = defaultdict(int)  # messages it was sent and has not answered
        self._lock = threading.Lock()
        self._cut: set[str] = set()  # links that are shut down for what they sent and not gone yet
        self._freed = False
        self._ended = threading.Event()

    def opened(self, name: str, session: str, locator: str) -> None:
        """A link is there: of a certificate's `name`, of a session by its number, from `locator`: tls/HOST:PORT."""
        self._refusals.met(session, name)
        with self._lock:
            self._links[locator] = _Link(name, self._explained[name])
            count = sum(link.name == name for link in self._links.values())
        if count > self._at_most(name):
            self._shut_down(locator, f"{name}: more than {self._at_most(name)} sessions at once")

    def closed(self, locator: str) -> None:
        """A link is gone."""
        with self._lock:
            self._links.pop(locator, None)
            if locator in self._cut:  # and what it held is free
                self._cut.remove(locator)
                self._freed = True

    def asked(self, name: str) -> None:
        """A message went to the holder of the certificate of that name, who may answer."""
        with self._lock:
            self._asked[name] = min(self._asked[name] + 1, ANSWERS)

    def explained(self, name: str, key: str, size: int) -> None:
        """A message of so many bytes has come with the certificate of that name. What is around it is explained as well
        if it is an answer, for of short messages nobody asked for one may send as many as one likes.
        """
        with self._lock:
            answers = self._asked[name] > 0
            self._asked[name] -= answers
            around = len(key) + MESSAGE_BYTES if answers else 0
            self._explained[name] += size + around + PER_FRAGMENT * (size // FRAGMENT_BYTES)

    def run(self) -> None:
        """Until `close`."""
        before, looked = resident(), time.monotonic()
        while can_count() and not self._ended.wait(LOOK_S):
            if self._freed:
                self._freed = False
                give_back()
            now = resident()
            if now - before >= GROWN_BYTES or time.monotonic() - looked >= LOOK_AT_LEAST_S:
                self.look()
                looked = time.monotonic()
                before = now

    def look(self) -> list[str]:
        """Shuts down the links that sent too much beside messages; returns where their other ends are."""
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
            self._shut_down(locator, f"{links[locator].name}: sends too much that is no message")
        return over

    def close(self) -> None:
        """Looks no more."""
        self._ended.set()
        if self.is_alive():
            self.join()

    def _shut_down(self, locator: str, why: str) -> None:
        if shut_down(locator):
            self._refusals.count("refused-session", why)


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
