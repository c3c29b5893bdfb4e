"""Many sessions of one genuine certificate send messages far longer than any node may: the world needs no memory."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import psutil
import pytest

from meanflock.swarm.net import keys
from tests.security.conftest import RUN, Flight

pytestmark = pytest.mark.processes

ME = "agent-3"
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
            assert process.stdout is not None
            assert [process.stdout.readline() for _ in range(SESSIONS)] == [b"begun\n"] * SESSIONS
        yield
        assert all(process.poll() is None for process in processes)
    finally:
        for process in processes:
            process.kill()
            process.wait()
            assert process.stdout is not None
            process.stdout.close()


@pytest.fixture
def memory_mb(flight: Flight) -> Iterator[list[float]]:
    """Memory of the world, MB, measured again and again."""
    measured, ended = [flight.rss_mb()], threading.Event()

    def watch() -> None:
        with suppress(psutil.NoSuchProcess):
            while not ended.wait(0.01):
                measured.append(flight.rss_mb())

    thread = threading.Thread(target=watch)
    thread.start()
    yield measured
    ended.set()
    thread.join()


def test_a_flood_from_many_sessions_of_one_certificate_changes_nothing(
    flight: Flight, undisturbed: str, memory_mb: list[float]
) -> None:
    with flood(flight):
        summary = flight.land()  # while it goes on
    assert summary["trajectory_sha256"] == undisturbed
    assert summary["lost"] == 0
    assert max(memory_mb) < MOST_MB
