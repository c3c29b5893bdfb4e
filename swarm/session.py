"""The bus over Zenoh; the only file that imports zenoh.

The world is the router and everyone else a client: no router binary, no multicast, loopback unless told otherwise.
Settings were chosen by measurement, see docs/performance.md.
"""

import logging
import os
import queue
import threading
import time
from collections.abc import Mapping
from typing import Any

# The runtime reads this once, when zenoh is loaded. One thread a task: the hand-over between threads is what a
# small message costs. `rx` and `tx` must never share a pool: the router can then wait for itself for ever.
os.environ.setdefault(
    "ZENOH_RUNTIME",
    "(acc:(handover:app),net:(handover:app),tx:(handover:app),app:(worker_threads:1),rx:(worker_threads:1))",
)

import msgspec
import zenoh

from swarm.access import NOBODY
from swarm.bus import Delivery, Offer
from swarm.codec import MAX_BYTES
from swarm.errors import BadInput, BusError
from swarm.identity import Identity
from swarm.refusals import FILTER, Refusals

log = logging.getLogger("meanflock.bus")

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"

_LEASE_MS = 10_000
_COMMON: Mapping[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,
    # Stamps are of the wall clock, and a router that sees it jump has a complaint for every message.
    "timestamping/enabled": False,
    # Shared memory is on by default from 3 KiB and can drop messages without a word.
    "transport/shared_memory/enabled": False,
    "transport/link/tx/lease": _LEASE_MS,
    "transport/link/rx/max_message_size": MAX_BYTES,
    # What is received is read into as much fresh memory as a batch may take. Of the default of 64 KiB, cleared for each
    # small message, the caches keep nothing else.
    "transport/link/tx/batch_size": 8192,
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 5_000_000,  # µs, below the lease
}
_ASK_AGAIN_S = 0.05
_BACKLOG_MESSAGES = 256  # an honest node has two or three under way
_BACKLOG_BYTES = 16 * 2**20
_RETRY = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}


def _config(settings: Mapping[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, msgspec.json.encode(value).decode())
    return config


class ZenohBus:
    """A `Bus` over one Zenoh session."""

    def __init__(
        self, config: zenoh.Config, log_filter: str = "error", limited: bool = False, refusals: Refusals | None = None
    ) -> None:
        """Use `router` or `client`. `limited`: no key may have more than a backlog of messages waiting."""
        zenoh.init_log_from_env_or(log_filter)
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            said = str(error).split(" at /")[0]  # without the place in the library's source
            raise BusError(f"cannot open a Zenoh session: {said}") from error
        self._queue: queue.SimpleQueue[Delivery] = queue.SimpleQueue()
        self._limited, self._refusals = limited, refusals
        self._waiting: dict[str, tuple[int, int]] = {}  # messages and their bytes, by key
        self._counting = threading.Lock()
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._declared: list[Any] = []
        self._closing = threading.Lock()
        self._closed = False

    @classmethod
    def router(
        cls,
        endpoint: str = DEFAULT_ENDPOINT,
        identity: Identity | None = None,
        access: Mapping[str, Any] | None = None,
        refusals: Refusals | None = None,
    ) -> "ZenohBus":
        """The world's side: listens on `endpoint` and relays between the clients.

        With an `identity`, every link is mutual TLS, and `access` says who may do what (`access.rules`; without it
        nobody may do anything). What comes in faster than it is received waits, up to a backlog for each key; what
        goes beyond is dropped and counted in `refusals`, so a flood under one key costs neither memory nor the
        messages under another.

        Raises:
            BadInput: the port is taken, the endpoint cannot be listened on, or a certificate cannot be used.
            BusError: the session cannot be opened for another reason.
        """
        endpoint = secured(endpoint, identity)
        check_free(endpoint)
        settings = {**_COMMON, "mode": "router", "listen/endpoints": [endpoint]}
        log_filter = "error"
        if identity is not None:
            settings |= _tls(identity, "listen")
            settings["access_control"] = access or NOBODY
            if refusals is not None:
                log_filter = FILTER
        return cls(_config(settings), log_filter, limited=True, refusals=refusals)

    @classmethod
    def client(
        cls, endpoint: str = DEFAULT_ENDPOINT, timeout_s: float = 30.0, identity: Identity | None = None
    ) -> "ZenohBus":
        """Everyone else's side: connects to the world, waiting up to `timeout_s` for it to come up.

        Raises:
            BadInput: a certificate cannot be used.
            BusError: no world answered in time, or it refused the certificate: it does not say which.
        """
        settings = {
            **_COMMON,
            "mode": "client",
            "connect/endpoints": [secured(endpoint, identity)],
            "connect/timeout_ms": int(timeout_s * 1000),
            "connect/exit_on_failure": True,
            "connect/retry": _RETRY,
        }
        if identity is not None:
            settings |= _tls(identity, "connect")
        try:
            return cls(_config(settings))
        except BusError as error:
            if identity is None:
                raise
            raise BusError(f"{error}; the world is not there, or refuses {identity.certificate}") from error

    def put(self, key: str, payload: bytes) -> None:
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._session.declare_publisher(
                key,
                congestion_control=zenoh.CongestionControl.BLOCK,
                reliability=zenoh.Reliability.RELIABLE,
                express=True,
            )
            self._publishers[key] = publisher
        publisher.put(payload)

    def subscribe(self, key: str, offer: Offer | None = None) -> None:
        put = self._queue.put
        only = None if "*" in key else key

        def receive(sample: zenoh.Sample) -> None:
            name, payload = only or str(sample.key_expr), sample.payload
            try:
                if offer is not None and offer(name, payload.to_bytes()):
                    return
            except Exception:  # in Zenoh's thread nobody else would hear of it
                if not self._closed:
                    log.exception("the message under %s was not taken", name)
            if not self._limited or self._has_room(name, len(payload)):
                put(Delivery("message", name, payload.to_bytes()))

        self._declared.append(self._session.declare_subscriber(key, receive))

    def answer(self, key: str) -> None:
        def receive(query: zenoh.Query) -> None:
            name = str(query.key_expr)
            if self._limited and not self._has_room(name, len(query.payload) if query.payload is not None else 0):
                return
            payload = query.payload.to_bytes() if query.payload is not None else b""

            def reply(answer: bytes) -> None:
                with query:
                    query.reply(query.key_expr, answer)

            self._queue.put(Delivery("question", name, payload, reply))

        self._declared.append(self._session.declare_queryable(key, receive))

    def ask(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        # Zenoh says at once that nobody offers answers; the world may be about to.
        end = time.monotonic() + timeout_s
        while (left := end - time.monotonic()) > 0:
            for reply in self._session.get(key, payload=payload, timeout=left):
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
            time.sleep(min(_ASK_AGAIN_S, max(0.0, end - time.monotonic())))
        return None

    def announce(self, key: str) -> None:
        self._declared.append(self._session.liveliness().declare_token(key))

    def watch(self, key: str) -> None:
        def receive(sample: zenoh.Sample) -> None:
            kind = "alive" if sample.kind == zenoh.SampleKind.PUT else "gone"
            self._queue.put(Delivery(kind, str(sample.key_expr)))  # type: ignore[arg-type]

        self._declared.append(self._session.liveliness().declare_subscriber(key, receive, history=True))

    def receive(self, timeout_s: float) -> Delivery | None:
        try:
            delivery = self._queue.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if self._limited and delivery.kind in ("message", "question"):
            with self._counting:
                count, size = self._waiting[delivery.key]
                if count > 1:
                    self._waiting[delivery.key] = (count - 1, size - len(delivery.payload))
                else:
                    del self._waiting[delivery.key]
        return delivery

    def _has_room(self, key: str, more: int) -> bool:
        """Whether one more message of that many bytes may wait under `key`; then it is counted in."""
        with self._counting:
            count, size = self._waiting.get(key, (0, 0))
            if fits := count < _BACKLOG_MESSAGES and (not count or size + more <= _BACKLOG_BYTES):
                self._waiting[key] = (count + 1, size + more)
        if not fits and self._refusals is not None:
            self._refusals.count("backlog", key)
        return fits

    def close(self) -> None:
        with self._closing:
            if self._closed:
                return
            self._closed = True
        try:
            self._session.close()
        except zenoh.ZError as error:  # a link on which nothing gets through any more
            log.warning("the session was left open: %s", str(error).split(" at /")[0])


def secured(endpoint: str, identity: Identity | None) -> str:
    """`endpoint` over TLS for who has an identity; so nobody has to say it twice.

    Raises:
        BadInput: it cannot be.
    """
    protocol, _, address = endpoint.partition("/")
    if identity is None:
        if protocol in ("tls", "quic"):
            raise BadInput(f"endpoint {endpoint}: needs certificates, name their folder: --tls DIR")
        return endpoint
    if protocol not in ("tcp", "tls"):
        raise BadInput(f"endpoint {endpoint}: with --tls it must be tls/HOST:PORT")
    return f"tls/{address}"


def _tls(identity: Identity, side: str) -> dict[str, Any]:
    """Mutual TLS and nothing else; `side`: "listen" or "connect"."""
    identity.check()
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls/root_ca_certificate": str(identity.authority),
        "transport/link/tls/enable_mtls": True,
        f"transport/link/tls/{side}_certificate": str(identity.certificate),
        f"transport/link/tls/{side}_private_key": str(identity.key),
    }


def check_free(endpoint: str) -> None:
    """Says which port is taken before Zenoh says that something failed.

    Raises:
        BadInput: `endpoint` cannot be listened on.
    """
    import socket  # only here: clients leave sockets to Zenoh

    _, slash, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if not slash or not host or not (port.isascii() and port.isdigit() and int(port) < 2**16):
        raise BadInput(f"endpoint {endpoint}: write it as tcp/HOST:PORT, for example {DEFAULT_ENDPOINT}")
    try:
        with socket.create_server((host.strip("[]"), int(port))):
            pass
    except OSError as error:
        reason = error.strerror or error
        raise BadInput(f"endpoint {endpoint}: {reason}; choose a free one, for example {DEFAULT_ENDPOINT}") from error
