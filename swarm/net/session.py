"""The bus over Zenoh; the only file that imports zenoh.

The world's process is the router and every other process a client: no router binary, no multicast, loopback by default.
Settings were chosen by measurement, see docs/performance.md.
"""

import logging
import math
import os
import queue
import socket
import stat
import struct
import threading
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

# The runtime reads this once, when zenoh is loaded. A small message costs the hand-over between threads, so the thread
# that waits for the sockets also reads them. Sending needs a thread of its own: the other thread hands messages to it
# (it tells every node of a link that is gone), and would wait for itself.
os.environ.setdefault(
    "ZENOH_RUNTIME",
    "(acc:(handover:app),net:(handover:app),rx:(handover:app),app:(worker_threads:1),tx:(worker_threads:1))",
)

import msgspec
import zenoh

from meanflock.swarm.errors import BadInput, BusError, printable
from meanflock.swarm.net.access import NOBODY, Identity
from meanflock.swarm.net.address import DEFAULT_ENDPOINT, check_free, secured
from meanflock.swarm.net.bus import Delivery, Offer, Quota, Quotas
from meanflock.swarm.wire.control import MAX_BYTES

log = logging.getLogger("meanflock.bus")

LEASE = "MEANFLOCK_LEASE"  # variable: seconds of silence after which the other end of a link is taken for gone
_LEASE_S = (1.0, 10.0, 600.0)  # least, default, most
_WAITING_MESSAGES = 256  # of one sender; an honest node has two or three under way
_WAITING_BYTES = 2**16  # of one sender, however short its messages have to be
_WAITING_LONGEST = 4  # or this many of the longest messages that it may send
_BATCH_BYTES = 4096  # received in one piece
_COMMON: Mapping[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,
    # Time stamps are of the wall clock, and a router that sees the clock jump complains about every message.
    "timestamping/enabled": False,
    # Shared memory is on by default from 3 KiB and can drop messages silently.
    "transport/shared_memory/enabled": False,
    "transport/link/rx/max_message_size": MAX_BYTES,
    # Each message is read into fresh memory of the size of a batch. The default of 64 KiB, cleared for each small
    # message, would push all else out of the caches; and each fragment of a message, however short, holds as much.
    "transport/link/tx/batch_size": _BATCH_BYTES,
    # With priorities a link may have sixteen messages under way in fragments; without, two. Ours all have the same.
    "transport/unicast/qos/enabled": False,
}
_ASK_AGAIN_S = 0.05
_KEY_BYTES = 1024  # room for the key and headers of a message
_RETRY = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}


def _config(settings: dict[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for path, value in (settings | _lease()).items():
        config.insert_json5(path, msgspec.json.encode(value).decode())
    return config


def _lease() -> dict[str, int]:
    """Zenoh's settings of how long a link may be silent, and how long a message may wait for a link.

    Two messages may wait for the same link, one after the other, and nothing is received meanwhile: three tenths of the
    lease each leave the other links time for a sign of life.

    Raises:
        BadInput: the variable is not such a number.
    """
    least, default, most = _LEASE_S
    text = os.environ.get(LEASE) or str(default)
    try:
        lease_s = float(text)
    except ValueError:
        lease_s = math.nan
    if not least <= lease_s <= most:
        raise BadInput(f"{LEASE}={text}: seconds from {least:g} to {most:g}; {default:g} where it is not set")
    return {
        "transport/link/tx/lease": int(1e3 * lease_s),
        "transport/link/tx/queue/congestion_control/block/wait_before_close": int(3e5 * lease_s),  # µs
    }


class Backlog:
    """Queue of received deliveries, filled from any thread, in which no sender may have more than its share."""

    def __init__(self, quotas: Quotas | None) -> None:
        """`quotas`: the sender of a message, and how long the message may be; None: no limit."""
        self.dropped: Counter[str] = Counter()  # deliveries beyond the share of their sender: `backlog`
        self._queue: queue.SimpleQueue[tuple[Delivery, str]] = queue.SimpleQueue()  # with the sender, if it is limited
        self._quotas = quotas
        self._waiting: dict[str, tuple[int, int]] = {}  # messages and their bytes, by sender
        self._counting = threading.Lock()

    def put(self, delivery: Delivery) -> None:
        """Adds a delivery if its sender has room for it."""
        owner = ""
        if self._quotas is not None:
            owner, largest = self._quotas(delivery.key)
            with self._counting:
                count, size = self._waiting.get(owner, (0, 0))
                size += len(delivery.payload)
                if fits := count < _WAITING_MESSAGES and size <= max(_WAITING_BYTES, _WAITING_LONGEST * largest):
                    self._waiting[owner] = (count + 1, size)
                else:
                    self.dropped["backlog"] += 1
                    dropped = self.dropped["backlog"]
            if not fits:
                if dropped & (dropped - 1) == 0:  # the 1st, 2nd, 4th, 8th …: a flood does not fill the log
                    log.warning(
                        "dropped %d messages, too many wait; the last under %s", dropped, printable(delivery.key)
                    )
                return
        self._queue.put((delivery, owner))

    def get(self, timeout_s: float) -> Delivery | None:
        """The next delivery; None if none comes in time."""
        try:
            delivery, owner = self._queue.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if self._quotas is not None:
            with self._counting:
                count, size = self._waiting[owner]
                if count > 1:
                    self._waiting[owner] = (count - 1, size - len(delivery.payload))
                else:
                    del self._waiting[owner]
        return delivery


class ZenohBus:
    """A `Bus` over one Zenoh session."""

    def __init__(self, config: zenoh.Config, quotas: Quotas | None = None) -> None:
        """Use `router` or `client`. `quotas`: how long the messages of a sender may be, and so how many bytes of them
        may wait; None: no limit.
        """
        zenoh.init_log_from_env_or("error")
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            reason = str(error).split(" at /")[0]  # without the place in the library's source
            raise BusError(f"cannot open a Zenoh session: {reason}") from error
        self._quotas = quotas
        self._backlog = Backlog(quotas)
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
        quotas: Quotas | None = None,
        largest: int = MAX_BYTES,
        nodes: int = 1000,
    ) -> "ZenohBus":
        """The world's side: listens on `endpoint` and relays between the clients.

        With an `identity`, every link is mutual TLS, and `access` says which node may do what (`access.rules`; without
        it no node may do anything). Messages that come in faster than they are received wait, up to a limit for each
        sender; further ones are dropped and counted in `dropped`, so a flood of one sender costs neither memory nor the
        messages of another. `quotas`: who the sender of a message is, and how long its messages may be; without it each
        key is a sender. `largest`: the longest message of any sender, bytes: Zenoh drops a longer one while it arrives.
        `nodes`: how many clients to expect.

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
        if identity is not None:
            settings |= _tls(identity, "listen")
            settings["access_control"] = access or NOBODY
        bus = cls(_config(settings), quotas or _a_key_a_sender)
        bus._close_links_without_waiting()
        return bus

    @classmethod
    def client(
        cls, endpoint: str = DEFAULT_ENDPOINT, timeout_s: float = 30.0, identity: Identity | None = None
    ) -> "ZenohBus":
        """A node's side: connects to the world, and waits up to `timeout_s` for it to come up.

        Raises:
            BadInput: a certificate cannot be used.
            BusError: no world answered in time, or it refused the certificate; Zenoh does not say which.
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
            refuses = "" if identity is None else f", or refuses {identity.certificate}"
            raise BusError(f"{error}; the world is not there{refuses}: start it, or wait longer (--wait)") from error

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
        only = None if "*" in key else key

        def receive(sample: zenoh.Sample) -> None:
            name, payload = only or str(sample.key_expr), sample.payload
            if not self._takes(name, len(payload)):
                return
            try:
                if offer is not None and offer(name, payload.to_bytes()):
                    return
            except Exception:  # in Zenoh's thread the error would be lost
                if not self._closed:
                    log.exception("the message under %s was not taken", name)
            self._backlog.put(Delivery("message", name, payload.to_bytes()))

        self._declared.append(self._session.declare_subscriber(key, receive))

    def answer(self, key: str) -> None:
        def receive(query: zenoh.Query) -> None:
            name, payload = str(query.key_expr), query.payload
            if not self._takes(name, len(payload or b"")):
                return

            def reply(answer: bytes) -> None:
                with query:
                    query.reply(query.key_expr, answer)

            self._backlog.put(Delivery("question", name, payload.to_bytes() if payload else b"", reply))

        self._declared.append(self._session.declare_queryable(key, receive))

    def ask(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        # Zenoh returns at once if no process answers yet; the world may be about to.
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
            self._backlog.put(Delivery("alive" if came else "gone", str(sample.key_expr)))

        self._declared.append(self._session.liveliness().declare_subscriber(key, receive, history=True))

    def receive(self, timeout_s: float) -> Delivery | None:
        return self._backlog.get(timeout_s)

    @property
    def dropped(self) -> Counter[str]:
        """Messages that were dropped because too many of their sender waited, under the reason `backlog`."""
        return self._backlog.dropped

    def _takes(self, key: str, size: int) -> bool:
        """Whether a message is as short as its sender's have to be; a longer one is received as its size alone."""
        if self._quotas is None:
            return True
        _, largest = self._quotas(key)
        if size > largest:
            self._backlog.put(Delivery("oversized", key, size=size, largest=largest))
        return size <= largest

    def _close_links_without_waiting(self) -> None:
        """From now on, the router closes a link at once, also while its other end is stopped."""

        def changed(event: zenoh.LinkEvent) -> None:
            if event.kind == zenoh.SampleKind.PUT:
                _do_not_linger(str(event.link.dst))

        self._declared.append(self._session.info.declare_link_events_listener(changed, history=True))

    def close(self) -> None:
        with self._closing:
            if self._closed:
                return
            self._closed = True
        try:
            self._session.close()
        except zenoh.ZError as error:  # a link on which nothing gets through any more
            log.warning("the session was left open: %s", str(error).split(" at /")[0])


def _a_key_a_sender(key: str) -> Quota:
    return Quota(key, MAX_BYTES // _WAITING_LONGEST)


def _do_not_linger(locator: str) -> None:
    """Lets the socket of this process whose other end is at `locator` close at once; the system sends what is left.

    Zenoh's sockets wait for up to ten seconds when they are closed before the other end has taken everything, and the
    router's only thread waits with them: a stopped launcher would stop the whole swarm. Zenoh has no setting for this
    and does not hand out its sockets, so the socket is looked for among the open files of the process.
    """
    host, _, port = locator.partition("/")[2].rpartition(":")
    for number in sorted(map(int, os.listdir("/dev/fd")), reverse=True):  # a new link has a high number, as a rule
        with suppress(OSError):  # closed meanwhile, or a socket without another end
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                with socket.socket(fileno=os.dup(number)) as link:
                    if link.getpeername()[:2] == (host.strip("[]"), int(port)):
                        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 0, 0))
                        return


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
