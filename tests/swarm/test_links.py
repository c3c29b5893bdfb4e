"""What a link sends beside messages: counted from the kernel's numbers, and named where it is too much."""

import socket
import threading
from collections.abc import Iterator
from contextlib import suppress

import pytest

from meanflock.swarm.net import sockets
from meanflock.swarm.net.links import ALLOWED_BYTES, MESSAGE_BYTES, Links
from meanflock.swarm.net.refusals import Refusals
from tests.polling import until

pytestmark = pytest.mark.skipif(not sockets.can_count(), reason="this system does not count the bytes of a socket")

KEY, LARGEST = "meanflock/r/node/agent-0/act", 1000


class Pair:
    """A link of this process, and its other end."""

    def __init__(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            self.far = socket.create_connection(server.getsockname())
            self.near, (host, port) = server.accept()
        self.locator = f"tls/{host}:{port}"

    def send(self, size: int) -> None:
        """So many bytes arrive and are read."""
        sender = threading.Thread(target=self.far.sendall, args=(bytes(size),))
        sender.start()
        while size:
            size -= len(self.near.recv(size))
        sender.join()


@pytest.fixture
def pair() -> Iterator[Pair]:
    made = Pair()
    yield made
    made.near.close()
    made.far.close()


def test_what_was_taken_from_a_socket_is_counted_and_what_waits_is_not(pair: Pair) -> None:
    pair.send(5000)
    assert sockets.received(pair.near) == 5000
    pair.far.sendall(bytes(300))
    pair.near.recv(300, socket.MSG_WAITALL | socket.MSG_PEEK)
    assert sockets.received(pair.near) == 5000


def test_a_link_that_is_shut_down_delivers_nothing_that_waits_and_no_file_is_left_open(pair: Pair) -> None:
    pair.far.sendall(bytes(300))
    pair.near.recv(300, socket.MSG_WAITALL | socket.MSG_PEEK)
    before = sorted(number for number, _ in sockets.open_sockets())
    assert sockets.shut_down(pair.locator)
    assert pair.near.recv(300) == b""
    assert sorted(number for number, _ in sockets.open_sockets()) == before
    assert not sockets.shut_down("tls/127.0.0.1:1")
    assert not sockets.shut_down("nowhere")


@pytest.fixture
def links() -> Links:
    return Links(lambda name: 1, LARGEST, Refusals())


def test_messages_explain_themselves_and_as_much_around_as_were_asked_for(pair: Pair, links: Links) -> None:
    links.opened("agent-0", "session", pair.locator)
    pair.send(ALLOWED_BYTES + LARGEST)  # its handshake and the like
    around = len(KEY) + MESSAGE_BYTES
    for _ in range(1000):
        links.asked("agent-0")
        pair.send(100 + around)
        links.explained("agent-0", KEY, 100)
    assert links.look() == []
    for _ in range(10):  # nobody asked
        pair.send(100 + around)
        links.explained("agent-0", KEY, 100)
    until(lambda: pair.locator in links.look() or pair.send(100), "the link named")
    assert pair.near.recv(1) == b""  # it is shut down


def test_what_another_sent_or_this_one_before_explains_nothing(pair: Pair, links: Links) -> None:
    links.explained("agent-0", KEY, 10**6)
    links.opened("agent-0", "session", pair.locator)
    links.explained("agent-1", KEY, 10**6)
    pair.send(2 * ALLOWED_BYTES)
    assert links.look() == [pair.locator]
    links.closed(pair.locator)
    assert links.look() == []


def test_a_flood_is_noticed_without_being_looked_for(pair: Pair, links: Links) -> None:
    links.start()
    links.opened("agent-0", "session", pair.locator)
    pair.send(2 * ALLOWED_BYTES)
    until(lambda: refused(links), "the link shut down")
    links.close()
    assert not links.is_alive()


def test_a_socket_that_is_gone_is_no_link_of_anybody(pair: Pair, links: Links) -> None:
    links.opened("agent-0", "session", pair.locator)
    pair.send(2 * ALLOWED_BYTES)
    assert links.look() == [pair.locator]
    pair.near.close()
    with suppress(OSError):
        pair.far.close()
    assert links.look() == []


def test_one_link_more_than_a_certificate_may_have_is_shut_down_and_counted(pair: Pair, links: Links) -> None:
    links.opened("agent-0", "session", "tls/127.0.0.1:1")
    links.opened("agent-1", "session", pair.locator)
    assert not refused(links)
    links.opened("agent-0", "session", pair.locator)
    assert refused(links) == 1
    assert pair.near.recv(1) == b""


def refused(links: Links) -> int:
    return links._refusals.counts["refused-session"]
