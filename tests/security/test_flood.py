"""Many sessions of one genuine certificate send messages far longer than any node may: the world needs no memory."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import psutil
import pytest

from meanflock.swarm import scenario
from meanflock.swarm.net import keys
from meanflock.worldsim.limits import Limits, Quotas
from tests.polling import until
from tests.security.conftest import ME, RUN, SETTINGS, Flight

pytestmark = pytest.mark.processes

FLOWN = scenario.load(None, SETTINGS)
LONGEST = Quotas(RUN, FLOWN, Limits(FLOWN), rows_at_most=1).largest  # bytes of a message of anyone
PROCESSES, SESSIONS, MEGABYTES = 5, 2, 60
MOST_MB = 200


@contextmanager
def flood(flight: Flight) -> Iterator[None]:
    """Ten sessions in five processes, from when all of them send."""
    where = [flight.endpoint, str(flight.certificates), ME, keys.act(RUN, ME), str(SESSIONS), str(MEGABYTES)]
    command = [sys.executable, "-m", "tests.security.flood", *where]
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE) for _ in range(PROCESSES)]
    try:
        for process in processes:
            assert [process.stdout.readline() for _ in range(SESSIONS)] == [b"begun\n"] * SESSIONS
        yield
        assert all(process.poll() is None for process in processes)
    finally:
        for process in processes:
            process.kill()
            process.wait()
            process.stdout.close()


@pytest.fixture
def memory_mb(flight: Flight) -> Iterator[list[float]]:
    world, ended, measured = psutil.Process(flight.world.pid), threading.Event(), [0.0]

    def watch() -> None:
        with suppress(psutil.NoSuchProcess):
            while not ended.wait(0.01):
                measured.append(world.memory_info().rss / 2**20)

    thread = threading.Thread(target=watch)
    thread.start()
    yield measured
    ended.set()
    thread.join()


def test_a_flood_of_messages_that_are_too_long_costs_neither_the_flight_nor_memory(
    flight: Flight, undisturbed: str, memory_mb: list[float]
) -> None:
    """Those of many sessions do not even reach the world; those that are hardly too long are counted."""
    ended, attacker = threading.Event(), flight.client(ME)

    def send() -> None:
        while not ended.is_set():
            attacker.put(keys.act(RUN, ME), bytes(LONGEST + 500))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        until(lambda: flight.said().count("oversized") >= 50, "fifty messages dropped")
        with flood(flight):
            summary = flight.land()  # while it goes on
    finally:
        ended.set()
        thread.join()
    assert summary["dropped_messages"]["oversized"] >= 50
    assert (summary["trajectory_sha256"], summary["lost"]) == (undisturbed, 0)
    assert max(memory_mb) < MOST_MB
