"""An agent with a genuine certificate that keeps all others waiting is lost.

The limit of rejoining: tests/faults/test_rejoin.py. All limits of time: tests/worldsim/test_pace.py.
"""

import signal
import threading
from pathlib import Path
from typing import Any

import pytest

from meanflock.agent.node import Agent
from meanflock.swarm.errors import Refused
from meanflock.swarm.net.bus import Bus
from meanflock.swarm.net.client import NodeClient
from meanflock.swarm.wire.messages import Join
from tests.polling import DEADLINE_S, until
from tests.security.conftest import ME, RUN, Flight, Folders, act_in

pytestmark = pytest.mark.processes

ENDLESS = ("duration=100000", "stop=duration", "method=fed-lspi")


class Late:
    """A bus over which each reply goes out a second late, from `begin` on."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.begin, self._never = threading.Event(), threading.Event()

    def put(self, key: str, payload: bytes) -> None:
        """Like a bus."""
        if self.begin.is_set() and act_in(payload) is not None:
            self._never.wait(1.0)
        self._bus.put(key, payload)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)


def test_an_agent_that_answers_just_in_time_is_lost_and_refused(folders: Folders, tmp_path: Path) -> None:
    settings = (*ENDLESS, "pace.wait_window_s=30")  # of which six late replies are a fifth
    flown = Flight(folders, tmp_path / "world.log", barrier_s=5.0, settings=settings)
    flown.go_on.set()
    buses: list[Late] = []

    def late(bus: Bus) -> Late:
        buses.append(Late(bus))
        return buses[-1]

    flown.buses[3] = late
    with flown as flight:
        buses[0].begin.set()
        flight.logs("lost agent-3: ")
        attacker = NodeClient(flight.client(ME), RUN)
        with pytest.raises(Refused, match=r"s: the agent of UAV 3 is lost: the others waited "):
            attacker.join(Join("agent", 1, 3), Agent, 0.0)
        before = len(flight.held.sent)
        until(lambda: len(flight.held.sent) > before + 100, "the others fly on")
        flight.world.send_signal(signal.SIGINT)
        flight.world.communicate(timeout=DEADLINE_S)
        for thread in flight.crew:
            thread.join(DEADLINE_S)
