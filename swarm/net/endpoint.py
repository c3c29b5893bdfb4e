"""Endpoints: `tcp/HOST:PORT`, or `tls/HOST:PORT` for who has an identity."""

from meanflock.swarm.errors import BadInput
from meanflock.swarm.net.address import Address
from meanflock.swarm.net.identity import Identity

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"


def secured(endpoint: str, identity: Identity | None) -> str:
    """`endpoint` over TLS for who has an identity; so nobody has to say it twice.

    Raises:
        BadInput: it cannot be.
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
    """Says which port is taken before Zenoh says that something failed.

    Raises:
        BadInput: `endpoint` cannot be listened on.
    """
    try:
        _address(endpoint).listen().close()
    except OSError as error:
        reason = error.strerror or error
        raise BadInput(f"endpoint {endpoint}: {reason}; choose a free one, for example {DEFAULT_ENDPOINT}") from error


def _address(endpoint: str) -> Address:
    """Raises BadInput where it is written otherwise."""
    _, _, text = endpoint.partition("/")
    if ":" not in text or (address := Address.of(text)) is None:
        raise BadInput(f"endpoint {endpoint}: write it as tcp/HOST:PORT, for example {DEFAULT_ENDPOINT}")
    return address
