"""The links of the router: whose certificate opened each, and no more of one certificate than its holder needs.

Zenoh limits the sessions of a router, not those of a certificate, nor what comes over one beside messages, and has no
call that ends one. But a link is a socket of this process, so one too many, or one with too much, is shut down, as if
its other end had gone.
"""

import threading
from collections import defaultdict
from collections.abc import Callable

from meanflock.swarm.net.overhead import Overhead
from meanflock.swarm.net.refusals import Refusals
from meanflock.swarm.net.sockets import can_count, shut_down


class Links:
    """Counts links by the name on the certificate, and shuts down those beyond what the name may have or send."""

    def __init__(self, at_most: Callable[[str], int], largest: int, refusals: Refusals | None = None) -> None:
        """`at_most`: how many links a name may have at once. `largest`: bytes of the longest message. `refusals`: where
        what is shut down is counted as `refused-session`, and what knows sessions by the name on their certificate.
        """
        self._at_most, self._refusals = at_most, refusals
        self._overhead = Overhead(largest, self._too_much) if can_count() else None
        if self._overhead is not None:
            self._overhead.start()
        self._open: defaultdict[str, set[str]] = defaultdict(set)  # locators of the other ends, by name
        self._lock = threading.Lock()

    def opened(self, name: str, session: str, locator: str) -> None:
        """A link is there: of a certificate's `name`, of a session by its number, from `locator`: tls/HOST:PORT."""
        if self._refusals is not None:
            self._refusals.met(session, name)
        with self._lock:
            self._open[name].add(locator)
            too_many = len(self._open[name]) > self._at_most(name)
        if self._overhead is not None:
            self._overhead.opened(name, locator)
        if too_many and shut_down(locator) and self._refusals is not None:
            self._refusals.count("refused-session", f"{name}: more than {self._at_most(name)} sessions at once")

    def asked(self, name: str) -> None:
        """A message went out for the holder of the certificate of that name."""
        if self._overhead is not None:
            self._overhead.asked(name)

    def explained(self, name: str, key: str, size: int) -> None:
        """A message of so many bytes has come with the certificate of that name."""
        if self._overhead is not None:
            self._overhead.explained(name, key, size)

    def _too_much(self, name: str, locator: str) -> None:
        if shut_down(locator) and self._refusals is not None:
            self._refusals.count("refused-session", f"{name}: sends too much that is no message")

    def closed(self, name: str, locator: str) -> None:
        """A link is gone."""
        with self._lock:
            self._open[name].discard(locator)
            if not self._open[name]:
                del self._open[name]
        if self._overhead is not None:
            self._overhead.closed(locator)

    def close(self) -> None:
        """Watches them no more."""
        if self._overhead is not None:
            self._overhead.close()
