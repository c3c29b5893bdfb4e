"""One genuine certificate against the world's memory: many sessions, messages far beyond what anybody may send, and
what is no message: fragments of a byte, and declarations without end."""

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import psutil
import pytest

from meanflock.swarm.net import keys
from meanflock.swarm.net.session import _SESSIONS
from meanflock.swarm.net.sockets import can_count
from tests.polling import until
from tests.security import wire
from tests.security.conftest import RUN, Flight

pytestmark = pytest.mark.processes

ME = "agent-3"
PROCESSES, SESSIONS, MEGABYTES = 5, 2, 60
MOST_MB = 200
UNFINISHED_MB = 90  # what one session can hold of fragments before it is cut off, however late that is noticed


@contextmanager
def flood(flight: Flight) -> Iterator[None]:
    """Ten sessions in five processes, from when the first has begun to send."""
    where = [flight.endpoint, str(flight.certificates), ME, keys.act(RUN, ME), str(SESSIONS), str(MEGABYTES)]
    command = [sys.executable, "-m", "tests.security.flood", *where]
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE) for _ in range(PROCESSES)]
    try:
        first = processes[0].stdout
        assert first is not None
        assert first.readline() == b"begun\n"
        yield
        assert any(process.poll() is None for process in processes)
    finally:
        for process in processes:
            process.kill()
            process.wait()
            assert process.stdout is not None
            process.stdout.close()


@contextmanager
def threads(*bodies: Callable[[], None]) -> Iterator[None]:
    """Each in a thread of its own, as long as the context lasts; they are told when it ends."""
    started = [threading.Thread(target=body) for body in bodies]
    for thread in started:
        thread.start()
    try:
        yield
    finally:
        ENDED.set()
        for thread in started:
            thread.join()


ENDED = threading.Event()  # whoever attacks or watches stops


@pytest.fixture
def most(flight: Flight) -> Iterator[list[float]]:
    """What the world had in memory, MB, again and again."""
    seen = [flight.rss_mb()]
    ENDED.clear()

    def watch() -> None:
        with suppress(psutil.NoSuchProcess):
            while not ENDED.wait(0.01):
                seen.append(flight.rss_mb())

    with threads(watch):
        yield seen


def test_a_flood_from_many_sessions_of_one_certificate_changes_nothing(
    flight: Flight, undisturbed: str, most: list[float]
) -> None:
    with flood(flight):
        until(lambda: f"refused-session: {ME}" in flight.said(), "sessions refused")
        summary = flight.land()  # while it goes on
    assert summary["trajectory_sha256"] == undisturbed
    assert summary["lost"] == 0
    assert summary["dropped_messages"]["refused-session"] > 0
    assert max(most) < MOST_MB, "MB in the world's memory"


@pytest.mark.skipif(not can_count(), reason="this system does not count the bytes of a socket")
@pytest.mark.parametrize("what", ["fragments of a byte", "declarations"])
def test_a_flood_of_what_is_no_message_is_cut_off_and_changes_nothing(
    what: str, flight: Flight, undisturbed: str, most: list[float]
) -> None:
    """As fast as five sessions can, each opened again when it is cut off."""

    def attack() -> None:
        while not ENDED.is_set():
            with suppress(OSError):
                session = wire.Session(flight.endpoint, flight.certificates, ME, priorities=True)
                assert not session.priorities  # of which each would have its own fragments
                for start in range(0, 2**28, 500):
                    if what == "declarations":
                        session.send(wire.interests(start, 500, length=100))
                    else:
                        session.send(wire.fragments(True, start, 500) + wire.fragments(False, start, 500))
                    if ENDED.is_set():
                        session.close()
                        break

    with threads(*[attack] * 5):
        said = f"refused-session: {ME}: sends too much that is no message (16 times)"
        until(lambda: said in flight.said(), "sixteen links cut off")
        summary = flight.land()  # while it goes on
    assert summary["trajectory_sha256"] == undisturbed
    assert summary["lost"] == summary["nodes_lost"] == 0
    assert summary["dropped_messages"]["refused-session"] >= 16
    assert max(most) < most[0] + _SESSIONS * UNFINISHED_MB, "MB in the world's memory"
