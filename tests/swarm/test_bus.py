"""Every bus, in memory and of Zenoh, keeps the same promises; links of a router that end cost no other link."""

import json
import os
import socket
import struct
import subprocess
import sys
import threading
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest

from meanflock.launch.processes import free_endpoint
from meanflock.net.bus import Bus, Delivery, Quota
from meanflock.net.session import LEASE, Backlog, ZenohBus, _config
from meanflock.swarm.errors import BadInput, BusError
from tests.polling import DEADLINE_S, until
from tests.swarm.conftest import Open


def next_of(bus: Bus, kind: str) -> Delivery:
    def of_that_kind() -> Delivery | None:
        delivery = bus.receive(0.1)
        return delivery if delivery is not None and delivery.kind == kind else None

    return until(of_that_kind, kind)


def put_until_heard(sender: Bus, receiver: Bus, key: str, payload: bytes) -> Delivery:
    """Declarations take a moment to spread, so the first message is repeated until it is heard."""

    def heard() -> Delivery | None:
        sender.put(key, payload)
        return receiver.receive(0.2)

    return until(heard, f"a message under {key}")


def drain(bus: Bus) -> None:
    while bus.receive(0.2) is not None:
        pass


def test_a_message_reaches_every_subscriber_of_its_key_and_nobody_else(network: Open) -> None:
    hub, one, other = network(), network(), network()
    hub.subscribe("t/*/act")
    one.subscribe("t/1/act")
    other.subscribe("t/2/act")
    assert put_until_heard(other, one, "t/1/act", b"x") == Delivery("message", "t/1/act", b"x")
    assert next_of(hub, "message").payload == b"x"
    assert other.receive(0.3) is None


def test_messages_of_one_publisher_arrive_in_order_and_whole(network: Open) -> None:
    hub, one = network(), network()
    hub.subscribe("t/act")
    put_until_heard(one, hub, "t/act", b"first")
    drain(hub)
    sent = [i.to_bytes(4, "little") * (1 + i % 5000) for i in range(200)]
    for payload in sent:
        one.put("t/act", payload)
    assert [next_of(hub, "message").payload for _ in sent] == sent


def test_a_message_may_be_longer_than_a_hundred_megabytes(network: Open) -> None:
    """As the uploads of a round of 100,000 UAVs to their leader."""
    hub, one = network(), network()
    one.subscribe("t/sense")
    put_until_heard(hub, one, "t/sense", b"first")
    drain(one)
    long = bytes(101 * 10**6)
    hub.put("t/sense", long)
    assert next_of(one, "message").payload == long


def test_a_message_that_is_taken_when_offered_is_not_received(network: Open) -> None:
    hub, one = network(), network()
    offered: list[tuple[str, bytes]] = []

    def offer(key: str, payload: bytes) -> bool:
        offered.append((key, payload))
        return payload != b"left"

    hub.subscribe("t/*/act", offer)
    until(lambda: one.put("t/1/act", b"taken") or offered, "an offer")
    drain(hub)
    offered.clear()
    for payload in (b"1", b"left", b"2"):
        one.put("t/1/act", payload)
    assert next_of(hub, "message") == Delivery("message", "t/1/act", b"left")
    until(lambda: len(offered) == 3, "all offers")
    assert offered == [("t/1/act", b"1"), ("t/1/act", b"left"), ("t/1/act", b"2")]
    assert hub.receive(0.2) is None


@pytest.mark.parametrize("network", ["zenoh"], indirect=True)
def test_an_offer_that_fails_is_logged_and_the_message_received(network: Open, caplog) -> None:
    hub, one = network(), network()

    def fail(_key: str, payload: bytes) -> bool:
        raise ValueError(payload.decode())

    one.subscribe("t", fail)
    assert put_until_heard(hub, one, "t", b"spilled").payload == b"spilled"
    one.close()  # again at the end, which is harmless
    assert "ValueError: spilled" in caplog.text


def test_a_question_is_answered_by_the_participant_that_offers_answers(network: Open) -> None:
    hub, one = network(), network()
    hub.answer("t/join")

    def serve() -> None:
        delivery = next_of(hub, "question")
        delivery.reply(b"welcome " + delivery.payload)

    server = threading.Thread(target=serve)
    server.start()
    assert one.ask("t/join", b"me", DEADLINE_S) == b"welcome me"
    server.join()
    assert one.ask("t/nobody", b"", 0.3) is None


def test_tokens_are_seen_by_watchers_early_and_late_and_vanish_with_their_owner(network: Open) -> None:
    hub, one = network(), network()
    hub.watch("t/alive/*/*")
    one.announce("t/alive/agent/a0")
    assert next_of(hub, "alive").key == "t/alive/agent/a0"
    late = network()
    late.watch("t/alive/*/*")
    assert next_of(late, "alive").key == "t/alive/agent/a0"
    one.close()
    assert next_of(hub, "gone").key == "t/alive/agent/a0"
    assert next_of(late, "gone").key == "t/alive/agent/a0"


def test_a_taken_port_a_missing_world_and_a_value_that_is_no_lease_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with pytest.raises(BadInput, match=str(port)):
            ZenohBus.router(f"tcp/127.0.0.1:{port}")
    with pytest.raises(BusError, match=r"the world is not there: start it, or wait longer \(--wait\)$"):
        ZenohBus.client(free_endpoint(), timeout_s=0.5)
    for value in ("0.5", "601", "nan", "soon"):
        monkeypatch.setenv(LEASE, value)
        with pytest.raises(BadInput, match=f"{LEASE}={value}: seconds from 1 to 600; unset: 10"):
            ZenohBus.client(free_endpoint(), 0.1)


@pytest.mark.parametrize(("largest", "length", "waiting"), [(25_000, 1, 256), (25_000, 5000, 20), (10, 1000, 65)])
def test_a_flood_of_one_sender_is_bounded_and_displaces_no_message_of_another(largest, length, waiting, caplog) -> None:
    backlog = Backlog(lambda key: Quota(key.partition("/")[0], largest))
    for number in range(300):
        backlog.put(Delivery("message", f"flood/{number}", bytes(length)))
    backlog.put(Delivery("message", "other/1", b"x"))
    received = [delivery for _ in range(301) if (delivery := backlog.get(0.0)) is not None]
    assert [delivery.key for delivery in received] == [*(f"flood/{number}" for number in range(waiting)), "other/1"]
    assert backlog.dropped == Counter(backlog=300 - waiting)
    assert len(caplog.records) == (300 - waiting).bit_length()
    backlog.put(Delivery("message", "flood/again", b"x"))  # its share is free again
    assert backlog.get(0.0) is not None


@pytest.mark.parametrize(
    ("listening", "connecting"), [("127.0.0.1", "127.0.0.1"), ("[::1]", "[::1]"), ("[::]", "127.0.0.1")]
)
def test_the_router_closes_a_link_without_waiting_for_its_other_end(listening: str, connecting: str) -> None:
    """The close of a socket that lingers would hold up the router's only thread, and so all other links."""
    port = int(free_endpoint().rpartition(":")[2])
    hub = ZenohBus.router(f"tcp/{listening}:{port}")
    client = ZenohBus.client(f"tcp/{connecting}:{port}")

    def lingering() -> list[int]:
        """Linger seconds of the files of this process that are links accepted at `port`."""
        found = []
        for number in map(int, os.listdir("/dev/fd")):
            if not Path(f"/dev/fd/{number}").is_socket():
                continue
            with suppress(OSError), socket.socket(fileno=os.dup(number)) as link:
                link.getpeername()
                if link.family in (socket.AF_INET, socket.AF_INET6) and link.getsockname()[1] == port:
                    found.append(struct.unpack("ii", link.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))[0])
        return found

    try:
        until(lambda: lingering() == [0], "one link that does not linger")
    finally:
        client.close()
        hub.close()


@pytest.mark.parametrize(("value", "lease_ms", "wait_us"), [("", 10_000, 3_000_000), ("2.5", 2500, 750_000)])
def test_a_message_waits_for_a_silent_link_for_three_tenths_of_its_lease(value, lease_ms, wait_us, monkeypatch) -> None:
    monkeypatch.setenv(LEASE, value)
    config = _config({})
    assert json.loads(config.get_json("transport/link/tx/lease")) == lease_ms
    queue = "transport/link/tx/queue/congestion_control/block/wait_before_close"
    assert json.loads(config.get_json(queue)) == wait_us


DYING = 20
CLIENTS = """
import sys
from meanflock.net.session import ZenohBus

endpoint, name, count = sys.argv[1:]
sessions = [ZenohBus.client(endpoint, 30.0) for _ in range(int(count))]
for number, bus in enumerate(sessions):
    bus.subscribe(f"links/to/{name}/{number}")
    bus.watch("links/alive/*/*")
    bus.announce(f"links/alive/{name}/{number}")
while True:
    for bus in sessions:
        bus.receive(0.01)
"""


@pytest.mark.processes
def test_clients_that_die_while_much_is_sent_cost_no_other_client_its_link() -> None:
    """The thread that reports the end of a link must not be the one that sends: else the router waits for itself for
    as long as a lease, and closes links that are well."""
    endpoint = free_endpoint()
    router, over = ZenohBus.router(endpoint), threading.Event()
    router.watch("links/alive/*/*")
    alive: dict[str, bool] = {}  # by key of a token
    clients: list[subprocess.Popen[bytes]] = []

    def wait_for(name: str, count: int) -> None:
        def present() -> bool:
            while (delivery := router.receive(0.01)) is not None:
                alive[delivery.key] = delivery.kind == "alive"
            return sum(is_alive for key, is_alive in alive.items() if name in key) == count

        until(present, f"{count} sessions of {name}", pause_s=0.0)

    def start(name: str, count: int) -> None:
        clients.append(subprocess.Popen([sys.executable, "-c", CLIENTS, endpoint, name, str(count)]))
        wait_for(name, count)

    def send(name: str, count: int, payload: bytes) -> None:
        while not over.wait(0.0005):
            for number in range(count):
                router.put(f"links/to/{name}/{number}", payload)

    loads = (("listener", 1, bytes(300_000)), ("dying", DYING, bytes(200)))
    sending = [threading.Thread(target=send, args=load) for load in loads]
    try:
        start("listener", 1)
        for thread in sending:
            thread.start()
        for _ in range(2):
            start("dying", DYING)
            clients[-1].kill()
            wait_for("dying", 0)
        assert alive["links/alive/listener/0"]
    finally:
        over.set()
        for thread in sending:
            thread.join()
        for client in clients:
            client.kill()
            client.wait()
        router.close()
