"""What a link sends beside messages: counted from the kernel's numbers, and named where it is too much."""

import socket
import threading
from collections.abc import Iterator
from contextlib import suppress

import pytest

from meanflock.swarm.net import sockets
from meanflock.swarm.net.overhead import ALLOWED_BYTES, MESSAGE_BYTES, Overhead
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


def test_messages_explain_themselves_and_as_much_around_as_were_asked_for(pair: Pair) -> None:
    cut: list[tuple[str, str]] = []
    overhead = Overhead(LARGEST, lambda *link: cut.append(link))
    overhead.opened("agent-0", pair.locator)
    pair.send(ALLOWED_BYTES + LARGEST)  # its handshake and the like
    around = len(KEY) + MESSAGE_BYTES
    for _ in range(1000):
        overhead.asked("agent-0")
        pair.send(100 + around)
        overhead.explained("agent-0", KEY, 100)
    assert (overhead.look(), cut) == ([], [])
    for _ in range(10):  # nobody asked
        pair.send(100 + around)
        overhead.explained("agent-0", KEY, 100)
    until(lambda: pair.locator in overhead.look() or pair.send(100), "the link named")
    assert cut[0] == ("agent-0", pair.locator)


def test_what_another_sent_or_this_one_before_explains_nothing(pair: Pair) -> None:
    cut: list[str] = []
    overhead = Overhead(LARGEST, lambda _, locator: cut.append(locator))
    overhead.explained("agent-0", KEY, 10**6)
    overhead.opened("agent-0", pair.locator)
    overhead.explained("agent-1", KEY, 10**6)
    pair.send(2 * ALLOWED_BYTES)
    assert overhead.look() == cut == [pair.locator]
    overhead.closed(pair.locator)
    assert overhead.look() == []


def test_a_flood_is_noticed_without_being_looked_for(pair: Pair) -> None:
    cut = threading.Event()
    overhead = Overhead(LARGEST, lambda *_: cut.set())
    overhead.start()
    overhead.opened("agent-0", pair.locator)
    pair.send(2 * ALLOWED_BYTES)
    assert cut.wait(60.0)
    overhead.close()
    assert not overhead.is_alive()


def test_a_socket_that_is_gone_is_no_link_of_anybody(pair: Pair) -> None:
    overhead = Overhead(LARGEST, lambda *_: None)
    overhead.opened("agent-0", pair.locator)
    pair.send(2 * ALLOWED_BYTES)
    assert overhead.look() == [pair.locator]
    pair.near.close()
    with suppress(OSError):
        pair.far.close()
    assert overhead.look() == []
