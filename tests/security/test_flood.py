"""One genuine certificate against the world's memory: many sessions, messages far beyond what anybody may send."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import psutil
import pytest

from meanflock.swarm.net import keys
from tests.polling import until
from tests.security.conftest import RUN, Flight

pytestmark = pytest.mark.processes

ME = "agent-3"
PROCESSES, SESSIONS, MEGABYTES = 5, 2, 60
MOST_MB = 200


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


def test_a_flood_from_many_sessions_of_one_certificate_changes_nothing(flight: Flight, undisturbed: str) -> None:
    most, ended = [flight.rss_mb()], threading.Event()

    def watch() -> None:
        with suppress(psutil.NoSuchProcess):
            while not ended.wait(0.01):
                most.append(flight.rss_mb())

    with flood(flight):
        thread = threading.Thread(target=watch)
        thread.start()
        try:
            until(lambda: f"refused-session: {ME}" in flight.said(), "sessions refused")
            summary = flight.land()  # while it goes on
        finally:
            ended.set()
            thread.join()
    assert summary["trajectory_sha256"] == undisturbed
    assert summary["lost"] == 0
    assert summary["dropped_messages"]["refused-session"] > 0
    assert max(most) < MOST_MB, "MB in the world's memory"
