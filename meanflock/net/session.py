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
from typing import Any, NamedTuple

# The runtime reads this once, when zenoh is loaded. The cost of a small message is a switch of threads, so the thread
# that waits for the sockets also reads them. Sending needs a thread of its own, because the receiving thread also sends
# (it tells every node that a link is gone), and would wait for itself.
os.environ.setdefault(
    "ZENOH_RUNTIME",
    "(acc:(handover:app),net:(handover:app),rx:(handover:app),app:(worker_threads:1),tx:(worker_threads:1))",
)

import msgspec
import zenoh

from meanflock.net.access import DEFAULT_ENDPOINT, NOBODY, Identity, connectable, free, secured
from meanflock.net.bus import Delivery, Offer, Quota, Quotas
from meanflock.swarm.errors import BadInput, BusError, printable
from meanflock.swarm.wire.control import MAX_BYTES

log = logging.getLogger("meanflock.bus")


class Bounds(NamedTuple):
    """Bounds of a setting, and its default."""

    least: float
    default: float
    most: float


LEASE_S = Bounds(1.0, 10.0, 600.0)
LEASE = "MEANFLOCK_LEASE"  # variable: seconds of silence after which a link counts as lost
_WAITING_MESSAGES = 256  # limit for one sender; an honest node has two or three
_WAITING_BYTES = 2**16  # limit for one sender, at least
_WAITING_LONGEST = 4  # or so many of its longest messages, if that is more
_BATCH_BYTES = 4096  # of a read
_COMMON: Mapping[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,
    # Time stamps use the wall clock; after a jump of the clock a router warns at every message.
    "timestamping/enabled": False,
    # Shared memory is on by default from 3 KiB and can drop messages silently.
    "transport/shared_memory/enabled": False,
    # Clients receive what the world sends, and of others what it lets through, see `router`.
    "transport/link/rx/max_message_size": MAX_BYTES,
    # Each message is read into new memory of the size of a batch. The default of 64 KiB, cleared for each small
    # message, would evict all other data from the caches, and each fragment of a message takes as much.
    "transport/link/tx/batch_size": _BATCH_BYTES,
    # With priorities a link may have sixteen fragmented messages under way; without, two. We use one priority.
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
    """Zenoh's settings of the time that a link may be silent, and that a message may wait for a link.

    Two messages may wait for the same link, one after the other, and nothing is received meanwhile. Each waits at most
    three tenths of the lease, so that the other links can still renew theirs.

    Raises:
        BadInput: the variable is not a number in this range.
    """
    least, default, most = LEASE_S
    text = os.environ.get(LEASE) or str(default)
    try:
        lease_s = float(text)
    except ValueError:
        lease_s = math.nan
    if not least <= lease_s <= most:
        raise BadInput(f"{LEASE}={text}: seconds from {least:g} to {most:g}; unset: {default:g}")
    return {
        "transport/link/tx/lease": int(1e3 * lease_s),
        "transport/link/tx/queue/congestion_control/block/wait_before_close": int(3e5 * lease_s),  # µs
    }


class Backlog:
    """Queue of received deliveries, filled from any thread, with a limit for each sender."""

    def __init__(self, quotas: Quotas | None) -> None:
        """`quotas`: sender and longest message of a key; None: no limit."""
        self.dropped: Counter[str] = Counter()  # deliveries beyond the limit of their sender: `backlog`
        self._queue: queue.SimpleQueue[tuple[Delivery, str]] = queue.SimpleQueue()  # str: the sender, if limited
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
                if dropped & (dropped - 1) == 0:  # the 1st, 2nd, 4th, 8th …, so that a flood does not fill the log
                    log.warning(
                        "dropped %d messages, because too many wait; the last under %s",
                        dropped,
                        printable(delivery.key),
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
    """A `Bus` over one Zenoh session. `endpoint`: where it listens; empty if it is a client."""

    def __init__(self, config: zenoh.Config, quotas: Quotas | None = None) -> None:
        """Use `router` or `client`. `quotas`: limits of a sender's messages; None: no limits."""
        zenoh.init_log_from_env_or("error")
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            reason = str(error).split(" at /")[0]  # without the location in the library's source
            raise BusError(f"cannot open a Zenoh session: {reason}") from error
        self._quotas = quotas
        self._backlog = Backlog(quotas)
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._declared: list[Any] = []
        self._closing = threading.Lock()
        self._closed = False
        self.endpoint = ""

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

        With an `identity`, every link is mutual TLS, and `access` has the rules of all nodes (`access.rules`; without
        it everything is denied). Messages that arrive faster than they are received wait, up to a limit for each
        sender. More messages are dropped and counted in `dropped`, so a flood of one sender costs neither memory nor
        the messages of another. `quotas`: sender and longest message of a key; without it each key is a sender.
        `largest`: longest message of all senders, bytes; Zenoh drops a longer one while it arrives. `nodes`: expected
        number of clients.

        Raises:
            BadInput: the port is taken, the endpoint cannot be listened on, or a certificate cannot be used.
            BusError: the session cannot be opened for another reason.
        """
        endpoint = free(secured(endpoint, identity))
        settings = {
            **_COMMON,
            "mode": "router",
            "listen/endpoints": [endpoint],
            # Each link stores up to two incomplete messages.
            "transport/link/rx/max_message_size": max(2 * _BATCH_BYTES, largest + _KEY_BYTES),
            "transport/unicast/max_sessions": 2 * nodes + 64,
        }
        if identity is not None:
            settings |= _tls(identity, "listen")
            settings["access_control"] = access or NOBODY
        bus = cls(_config(settings), quotas or _quota_of_key)
        bus.endpoint = endpoint
        bus._close_links_without_waiting()
        return bus

    @classmethod
    def client(
        cls, endpoint: str = DEFAULT_ENDPOINT, timeout_s: float = 30.0, identity: Identity | None = None
    ) -> "ZenohBus":
        """A node's side: connects to the world, and waits up to `timeout_s` for it to come up.

        Raises:
            BadInput: the endpoint or a certificate cannot be used.
            BusError: no world answered in time, or it refused the certificate; Zenoh does not say which.
        """
        settings = {
            **_COMMON,
            "mode": "client",
            "connect/endpoints": [connectable(endpoint, identity)],
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
        (self._publishers.get(key) or self._publisher(key, zenoh.CongestionControl.BLOCK)).put(payload)

    def tell(self, key: str, payload: bytes) -> None:
        (self._publishers.get(key) or self._publisher(key, zenoh.CongestionControl.DROP)).put(payload)

    def _publisher(self, key: str, congestion: zenoh.CongestionControl) -> zenoh.Publisher:
        self._publishers[key] = self._session.declare_publisher(
            key, congestion_control=congestion, reliability=zenoh.Reliability.RELIABLE, express=True
        )
        return self._publishers[key]

    def subscribe(self, key: str, offer: Offer | None = None) -> None:
        only = None if "*" in key else key

        def receive(sample: zenoh.Sample) -> None:
            name, payload = only or str(sample.key_expr), sample.payload
            if not self._takes(name, len(payload)):
                return
            try:
                if offer is not None and offer(name, payload.to_bytes()):
                    return
            except Exception:  # Zenoh's thread would lose the error
                if not self._closed:
                    log.exception("the message under %s failed", name)
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
        # Zenoh returns at once if no process answers yet, so ask again until the timeout.
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
            is_alive = sample.kind == zenoh.SampleKind.PUT
            self._backlog.put(Delivery("alive" if is_alive else "gone", str(sample.key_expr)))

        self._declared.append(self._session.liveliness().declare_subscriber(key, receive, history=True))

    def receive(self, timeout_s: float) -> Delivery | None:
        return self._backlog.get(timeout_s)

    @property
    def dropped(self) -> Counter[str]:
        """Number of messages dropped because too many of their sender waited, under the reason `backlog`."""
        return self._backlog.dropped

    def _takes(self, key: str, size: int) -> bool:
        """Returns whether a message is within its sender's limit; of a longer message only the size is received."""
        if self._quotas is None:
            return True
        _, largest = self._quotas(key)
        if size > largest:
            self._backlog.put(Delivery("oversized", key, size=size, largest=largest))
        return size <= largest

    def _close_links_without_waiting(self) -> None:
        """Make the router close links at once, even if the process at the other end is stopped."""

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
        except zenoh.ZError as error:  # a link is blocked
            log.warning("the session was left open: %s", str(error).split(" at /")[0])


def _quota_of_key(key: str) -> Quota:
    return Quota(key, MAX_BYTES // _WAITING_LONGEST)


def _do_not_linger(locator: str) -> None:
    """Set SO_LINGER to 0 on the socket whose other end is at `locator`, so that closing it does not block.

    Zenoh's sockets block for up to ten seconds when they are closed with unsent data, and so does the router's only
    thread: a stopped launcher would stop the whole swarm. Zenoh has no setting for this and does not expose its
    sockets, so this function searches the open files of the process.
    """
    host, _, port = locator.partition("/")[2].rpartition(":")
    if not port.isdigit():  # the path of a socket, which does not linger
        return
    for number in sorted(map(int, os.listdir("/dev/fd")), reverse=True):  # a new link usually has a high number
        with suppress(OSError):  # closed meanwhile, or a socket without another end
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                with socket.socket(fileno=os.dup(number)) as link:
                    if link.getpeername()[:2] == (host.strip("[]"), int(port)):
                        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 0, 0))
                        return


def _tls(identity: Identity, side: str) -> dict[str, Any]:
    """Settings of mutual TLS as the only protocol; `side`: "listen" or "connect"."""
    identity.check()
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls/root_ca_certificate": str(identity.authority),
        "transport/link/tls/enable_mtls": True,
        f"transport/link/tls/{side}_certificate": str(identity.certificate),
        f"transport/link/tls/{side}_private_key": str(identity.key),
    }
