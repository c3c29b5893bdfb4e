"""Addresses of processes that listen: `[HOST:]PORT`, and the world's endpoint `tcp/HOST:PORT` or `tls/HOST:PORT`."""

import socket
from typing import NamedTuple

from meanflock.swarm.errors import BadInput
from meanflock.swarm.net.access import Identity

LOOPBACK = "127.0.0.1"
DEFAULT_ENDPOINT = f"tcp/{LOOPBACK}:7447"


class Address(NamedTuple):
    """A host and a port; port 0 is any free one."""

    host: str
    port: int

    @classmethod
    def read(cls, text: str) -> "Address | None":
        """The address in a text `[HOST:]PORT`; None if the text is written otherwise."""
        host, colon, port = text.rpartition(":")
        if not (port.isascii() and port.isdigit() and int(port) < 2**16) or (colon and not host):
            return None
        return cls(host.strip("[]") or LOOPBACK, int(port))

    @classmethod
    def parse(cls, flag: str, text: str) -> "Address":
        """The address in a text `[HOST:]PORT` that was given to `flag`.

        Raises:
            BadInput: the text is written otherwise.
        """
        if (address := cls.read(text)) is None:
            raise BadInput(f"{flag} {text}: write it as PORT or HOST:PORT, for example {flag}={LOOPBACK}:9464")
        return address

    def listen(self) -> socket.socket:
        """A socket that listens there; raises OSError if none can."""
        return socket.create_server(self, family=socket.AF_INET6 if ":" in self.host else socket.AF_INET)

    def free(self, flag: str) -> "Address":
        """This address if no process listens there; port 0 becomes a free one.

        Raises:
            BadInput: a process listens there, or the host is not this machine.
        """
        try:
            with self.listen() as server:
                return Address(self.host, server.getsockname()[1])
        except OSError as error:
            raise self.refused(flag, error) from error

    def refused(self, flag: str, error: OSError) -> BadInput:
        """The error for an address at which no process can listen."""
        why = str(error.strerror).partition(" (while ")[0]  # the text has the address already
        return BadInput(f"{flag} {self}: {why}; choose a free port of this machine, or 0 for any")

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def secured(endpoint: str, identity: Identity | None) -> str:
    """`endpoint`, with `tls/` in place of `tcp/` for a process with an identity.

    Raises:
        BadInput: the endpoint is malformed, or its protocol does not fit.
    """
    _address(endpoint)
    protocol, _, address = endpoint.partition("/")
    if identity is None:
        if protocol in ("tls", "quic"):
            raise BadInput(f"endpoint {endpoint}: needs certificates, name their folder: --tls DIR")
        return endpoint
    if protocol not in ("tcp", "tls"):
        raise BadInput(f"endpoint {endpoint}: with --tls it must be tls/HOST:PORT")
    return f"tls/{address}"


def check_free(endpoint: str) -> None:
    """Checks that a process can listen on `endpoint`, because Zenoh's error does not name the port.

    Raises:
        BadInput: no process can listen there.
    """
    try:
        _address(endpoint).listen().close()
    except OSError as error:
        reason = error.strerror or error
        raise BadInput(f"endpoint {endpoint}: {reason}; choose a free one, for example {DEFAULT_ENDPOINT}") from error


def _address(endpoint: str) -> Address:
    """The address of an endpoint; raises BadInput if the endpoint is malformed."""
    _, _, text = endpoint.partition("/")
    if ":" not in text or (address := Address.read(text)) is None:
        raise BadInput(f"endpoint {endpoint}: write it as tcp/HOST:PORT, for example {DEFAULT_ENDPOINT}")
    return address
