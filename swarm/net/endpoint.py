"""Endpoints: `tcp/HOST:PORT`, or `tls/HOST:PORT` for who has an identity."""

from meanflock.swarm.errors import BadInput
from meanflock.swarm.net.identity import Identity

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"


def secured(endpoint: str, identity: Identity | None) -> str:
    """`endpoint` over TLS for who has an identity; so nobody has to say it twice.

    Raises:
        BadInput: it cannot be.
    """
    _host_and_port(endpoint)
    protocol, _, address = endpoint.partition("/")
    if identity is None:
        if protocol in ("tls", "quic"):
            raise BadInput(f"endpoint {endpoint}: needs certificates, name their folder: --tls DIR")
        return endpoint
    if protocol not in ("tcp", "tls"):
        raise BadInput(f"endpoint {endpoint}: with --tls it must be tls/HOST:PORT")
    return f"tls/{address}"


def check_free(endpoint: str) -> None:
    """Says which port is taken before Zenoh says that something failed.

    Raises:
        BadInput: `endpoint` cannot be listened on.
    """
    import socket  # only here: clients leave sockets to Zenoh

    try:
        with socket.create_server(_host_and_port(endpoint)):
            pass
    except OSError as error:
        reason = error.strerror or error
        raise BadInput(f"endpoint {endpoint}: {reason}; choose a free one, for example {DEFAULT_ENDPOINT}") from error


def _host_and_port(endpoint: str) -> tuple[str, int]:
    """Raises BadInput where it is written otherwise."""
    _, slash, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if not slash or not host or not (port.isascii() and port.isdigit() and int(port) < 2**16):
        raise BadInput(f"endpoint {endpoint}: write it as tcp/HOST:PORT, for example {DEFAULT_ENDPOINT}")
    return host.strip("[]"), int(port)
