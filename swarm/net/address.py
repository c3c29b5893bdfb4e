"""Where a process listens: a host and a port, loopback unless told otherwise."""

import socket
from typing import NamedTuple

from meanflock.swarm.errors import BadInput

LOOPBACK = "127.0.0.1"


class Address(NamedTuple):
    """A host and a port; port 0 is any that is free."""

    host: str
    port: int

    @classmethod
    def of(cls, text: str) -> "Address | None":
        """`[HOST:]PORT`; None where it is not."""
        host, colon, port = text.rpartition(":")
        if not (port.isascii() and port.isdigit() and int(port) < 2**16) or (colon and not host):
            return None
        return cls(host.strip("[]") or LOOPBACK, int(port))

    @classmethod
    def parse(cls, flag: str, text: str) -> "Address":
        """`[HOST:]PORT`, as somebody gave it to `flag`.

        Raises:
            BadInput: it is not.
        """
        if (address := cls.of(text)) is None:
            raise BadInput(f"{flag} {text}: write it as PORT or HOST:PORT, for example {flag}={LOOPBACK}:9464")
        return address

    def listen(self) -> socket.socket:
        """A socket that listens there; OSError where none can."""
        return socket.create_server(self, family=socket.AF_INET6 if ":" in self.host else socket.AF_INET)

    def free(self, flag: str) -> "Address":
        """Itself, if nobody listens there; port 0 becomes one that is free.

        Raises:
            BadInput: somebody does, or this machine is not there.
        """
        try:
            with self.listen() as server:
                return Address(self.host, server.getsockname()[1])
        except OSError as error:
            raise self.refused(flag, error) from error

    def refused(self, flag: str, error: OSError) -> BadInput:
        """What to say where it cannot be listened on."""
        why = str(error.strerror).partition(" (while ")[0]  # the address stands there already
        return BadInput(f"{flag} {self}: {why}; choose a free port of this machine, or 0 for any")

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"
