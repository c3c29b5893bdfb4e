"""The bus over Zenoh; the only file that imports zenoh.

The world is the router and everyone else a client: no router binary, no multicast, loopback unless told otherwise.
Settings were chosen by measurement, see docs/performance.md.
"""

import logging
import os
import threading
import time
from collections.abc import Mapping
from typing import Any

# The runtime reads this once, when zenoh is loaded. The hand-over between threads is what a small message costs: the
# one that waits for the sockets also reads them. What sends must have a thread of its own: the other one hands messages
# to it (it tells everyone of a link that is gone), and would wait for itself.
os.environ.setdefault(
    "ZENOH_RUNTIME",
    "(acc:(handover:app),net:(handover:app),rx:(handover:app),app:(worker_threads:1),tx:(worker_threads:1))",
)

import msgspec
import zenoh

from meanflock.swarm.errors import BusError
from meanflock.swarm.net.access import NOBODY
from meanflock.swarm.net.backlog import LARGEST, Backlog
from meanflock.swarm.net.bus import Delivery, Offer, Quota, Quotas
from meanflock.swarm.net.endpoint import DEFAULT_ENDPOINT, check_free, secured
from meanflock.swarm.net.identity import LEADER, Identity
from meanflock.swarm.net.lease import lease
from meanflock.swarm.net.links import Links
from meanflock.swarm.net.refusals import FILTER, Refusals
from meanflock.swarm.net.sockets import close_without_waiting
from meanflock.swarm.wire.control import MAX_BYTES

log = logging.getLogger("meanflock.bus")

_BATCH_BYTES = 4096  # of what is received in one piece
_COMMON: Mapping[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,
    # Stamps are of the wall clock, and a router that sees it jump has a complaint for every message.
    "timestamping/enabled": False,
    # Shared memory is on by default from 3 KiB and can drop messages without a word.
    "transport/shared_memory/enabled": False,
    "transport/link/rx/max_message_size": MAX_BYTES,
    # What is received is read into as much fresh memory as a batch may take. Of the default of 64 KiB, cleared for each
    # small message, the caches keep nothing else; and as much is held by each fragment of a message, however short.
    "transport/link/tx/batch_size": _BATCH_BYTES,
    # With priorities a link may have sixteen messages under way in fragments; without, two. All of ours have the same.
    "transport/unicast/qos/enabled": False,
}
_ASK_AGAIN_S = 0.05
_KEY_BYTES = 1024  # a message on the way is longer by its key and the like
_SESSIONS = 4  # of one certificate: a node that comes back may have left some behind that are not missed yet
_LEADER_SESSIONS = 12  # one certificate for the leader and its standbys
_RETRY = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}


def _config(settings: dict[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for path, value in (settings | lease()).items():
        config.insert_json5(path, msgspec.json.encode(value).decode())
    return config


class ZenohBus:
    """A `Bus` over one Zenoh session."""

    def __init__(
        self,
        config: zenoh.Config,
        log_filter: str = "error",
        quotas: Quotas | None = None,
        refusals: Refusals | None = None,
    ) -> None:
        """Use `router` or `client`. `quotas`: no sender may have more than a backlog of messages waiting, none of them
        longer than its quota says. `refusals`: where what is not taken in is counted.
        """
        zenoh.init_log_from_env_or(log_filter)
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            said = str(error).split(" at /")[0]  # without the place in the library's source
            raise BusError(f"cannot open a Zenoh session: {said}") from error
        self._quotas, self._refusals = quotas, refusals or Refusals()
        self._backlog = Backlog(quotas, self._refusals)
        self._links: Links | None = None
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
        quotas: Quotas | None = None,
        largest: int = MAX_BYTES,
        nodes: int = 1000,
    ) -> "ZenohBus":
        """The world's side: listens on `endpoint` and relays between the clients.

        With an `identity`, every link is mutual TLS, and `access` says who may do what (`access.rules`; without it
        nobody may do anything). What comes in faster than it is received waits, up to a backlog for each sender; what
        goes beyond is dropped and counted in `refusals`, so the flood of one costs neither memory nor the messages of
        another. `quotas`: who the senders are, and how long their messages may be; without it each key is a sender.
        `largest`: the longest message of anyone, bytes: what is longer is dropped while it arrives. `nodes`: how many
        clients to expect.

        Raises:
            BadInput: the port is taken, the endpoint cannot be listened on, or a certificate cannot be used.
            BusError: the session cannot be opened for another reason.
        """
        endpoint = secured(endpoint, identity)
        check_free(endpoint)
        settings = {
            **_COMMON,
            "mode": "router",
            "listen/endpoints": [endpoint],
            # Each link keeps up to two messages that have not arrived whole.
            "transport/link/rx/max_message_size": min(max(2 * _BATCH_BYTES, largest + _KEY_BYTES), MAX_BYTES),
            "transport/unicast/max_sessions": 2 * nodes + 64,
        }
        log_filter = "error"
        if identity is not None:
            settings |= _tls(identity, "listen")
            settings["access_control"] = access or NOBODY
            if refusals is not None:
                log_filter = FILTER
        bus = cls(_config(settings), log_filter, quotas or _a_key_a_sender, refusals)
        bus._attend_links(None if identity is None else largest)
        return bus

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
            else_ = "" if identity is None else f", or refuses {identity.certificate}"
            raise BusError(f"{error}; the world is not there{else_}: start it, or wait longer (--wait)") from error

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
        if self._links is not None and self._quotas is not None:
            self._links.asked(self._quotas(key).name)  # before: the answer may be here at once
        publisher.put(payload)

    def subscribe(self, key: str, offer: Offer | None = None) -> None:
        only = None if "*" in key else key

        def receive(sample: zenoh.Sample) -> None:
            name, payload = only or str(sample.key_expr), sample.payload
            if not self._takes(name, len(payload)):
                return
            try:
                if offer is not None and offer(name, payload.to_bytes()):
                    return
            except Exception:  # in Zenoh's thread nobody else would hear of it
                if not self._closed:
                    log.exception("the message under %s was not taken", name)
            self._backlog.keep(Delivery("message", name, payload.to_bytes()))

        self._declared.append(self._session.declare_subscriber(key, receive))

    def answer(self, key: str) -> None:
        def receive(query: zenoh.Query) -> None:
            name, payload = str(query.key_expr), query.payload
            if not self._takes(name, len(payload or b"")):
                return

            def reply(answer: bytes) -> None:
                with query:
                    query.reply(query.key_expr, answer)

            self._backlog.keep(Delivery("question", name, payload.to_bytes() if payload else b"", reply))

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
            came = sample.kind == zenoh.SampleKind.PUT
            self._backlog.keep(Delivery("alive" if came else "gone", str(sample.key_expr)))

        self._declared.append(self._session.liveliness().declare_subscriber(key, receive, history=True))

    def receive(self, timeout_s: float) -> Delivery | None:
        return self._backlog.receive(timeout_s)

    def _takes(self, key: str, size: int) -> bool:
        """Whether what came is no longer than its sender may send; else it is received as so many bytes."""
        if self._quotas is None:
            return True
        _, largest, name = self._quotas(key)
        if self._links is not None:
            self._links.explained(name, key, size)
        if size > largest:
            self._backlog.keep(Delivery("oversized", key, size=size, largest=largest))
        return size <= largest

    def _attend_links(self, largest: int | None) -> None:
        """Sees every link of the router come and go. `largest`: bytes of the longest message, where links are TLS and
        their certificates are limited.
        """
        links: Links | None = None
        if largest is not None:
            links = self._links = Links(_sessions, largest, self._refusals)
            links.start()

        def changed(event: zenoh.LinkEvent) -> None:
            locator, opened = str(event.link.dst), event.kind == zenoh.SampleKind.PUT
            if opened:
                close_without_waiting(locator)
            if links is not None and opened:
                links.opened(event.link.auth_identifier or "", str(event.link.zid), locator)
            elif links is not None:
                links.closed(locator)

        self._declared.append(self._session.info.declare_link_events_listener(changed, history=True))

    def close(self) -> None:
        with self._closing:
            if self._closed:
                return
            self._closed = True
        if self._links is not None:
            self._links.close()
        try:
            self._session.close()
        except zenoh.ZError as error:  # a link on which nothing gets through any more
            log.warning("the session was left open: %s", str(error).split(" at /")[0])


def _a_key_a_sender(key: str) -> Quota:
    return Quota(key, MAX_BYTES // LARGEST)


def _sessions(name: str) -> int:
    """How many sessions may be open at once with the certificate of that name."""
    return _LEADER_SESSIONS if name == LEADER else _SESSIONS


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
