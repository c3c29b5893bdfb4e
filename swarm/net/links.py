"""The links of the router: whose certificate opened each, and no more of one certificate than its holder needs.

Zenoh limits the sessions of a router, not those of a certificate, and has no call that ends one. But a link is a socket
of this process, so one too many is shut down, as if its other end had gone.
"""

import ipaddress
import os
import socket
import threading
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress

from meanflock.swarm.net.refusals import Refusals

_FOLDERS = ("/proc/self/fd", "/dev/fd")  # Linux; other systems


class Links:
    """Counts links by the name on the certificate, and shuts down those beyond what the name may have."""

    def __init__(self, at_most: Callable[[str], int], refusals: Refusals | None = None) -> None:
        """`at_most`: how many links a name may have at once. `refusals`: where what is shut down is counted as
        `refused-session`, and what knows sessions by the name on their certificate.
        """
        self._at_most, self._refusals = at_most, refusals
        self._open: defaultdict[str, set[str]] = defaultdict(set)  # locators of the other ends, by name
        self._lock = threading.Lock()

    def opened(self, name: str, session: str, locator: str) -> None:
        """A link is there: of a certificate's `name`, of a session by its number, from `locator`: tls/HOST:PORT."""
        if self._refusals is not None:
            self._refusals.met(session, name)
        with self._lock:
            self._open[name].add(locator)
            too_many = len(self._open[name]) > self._at_most(name)
        if too_many and shut_down(locator) and self._refusals is not None:
            self._refusals.count("refused-session", f"{name}: more than {self._at_most(name)} sessions at once")

    def closed(self, name: str, locator: str) -> None:
        """A link is gone."""
        with self._lock:
            self._open[name].discard(locator)
            if not self._open[name]:
                del self._open[name]


def shut_down(locator: str) -> bool:
    """Shuts down the socket of this process whose other end is at `locator`; whether there was one."""
    wanted = _address(locator)
    folder = next((path for path in _FOLDERS if os.path.isdir(path)), None)
    for number in os.listdir(folder) if folder else ():
        with suppress(OSError, ValueError), socket.socket(fileno=os.dup(int(number))) as link:
            if _normal(link.getpeername()) == wanted:
                link.shutdown(socket.SHUT_RDWR)
                return True
    return False


def _address(locator: str) -> tuple[str, int] | None:
    host, _, port = locator.partition("/")[2].rpartition(":")
    try:
        return _normal((host.strip("[]"), int(port)))
    except ValueError:
        return None


def _normal(address: object) -> tuple[str, int] | None:
    """Host and port, an IPv4 address in IPv6 as itself; None for what is no address on a network."""
    if not isinstance(address, tuple):
        return None
    host = ipaddress.ip_address(address[0].partition("%")[0])
    mapped = host.ipv4_mapped if isinstance(host, ipaddress.IPv6Address) else None
    return str(mapped or host), address[1]
