"""An agent with a genuine certificate that keeps all others waiting is lost, and kept out if it rejoins too often."""

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
from tests.security.attacks import ME
from tests.security.conftest import RUN, Flight, Folders, act_in

pytestmark = pytest.mark.processes

ENDLESS = ("duration=100000", "stop=duration", "method=fed-lspi")


class Late:
    """A bus over which each answer goes out late, or never, from `begin` on."""

    def __init__(self, bus: Bus, delay_s: float | None) -> None:
        self._bus, self._delay_s = bus, delay_s
        self.begin, self._never = threading.Event(), threading.Event()

    def put(self, key: str, payload: bytes) -> None:
        """Like a bus."""
        if self.begin.is_set() and act_in(payload) is not None:
            if self._delay_s is None:
                return
            self._never.wait(self._delay_s)
        self._bus.put(key, payload)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)


@pytest.mark.parametrize(
    ("delay_s", "barrier_s", "rejoins", "verdict"),
    [
        (None, 2.0, 5, "refused for good: the agent of UAV 3 joined again 5 times within 1000000 ticks"),
        (1.0, 5.0, 0, "s: the agent of UAV 3 is lost: the others waited "),
    ],
    ids=["never answers", "answers just in time"],
)
def test_an_agent_that_keeps_the_others_waiting_is_lost_and_refused(
    delay_s: float | None, barrier_s: float, rejoins: int, verdict: str, folders: Folders, tmp_path: Path
) -> None:
    window_s = 150 if delay_s is None else 30  # of which five barriers are not a fifth, or six late answers are
    settings = (*ENDLESS, "pace.rejoin_ticks=1000000", f"pace.wait_window_s={window_s}")
    flown = Flight(folders, tmp_path / "world.log", barrier_s=barrier_s, settings=settings)
    flown.go_on.set()
    buses: list[Late] = []

    def late(bus: Bus) -> Late:
        buses.append(Late(bus, delay_s))
        return buses[-1]

    flown.buses[3] = late
    with flown as flight:
        buses[0].begin.set()
        flight.logs("lost agent-3: ")
        let_in, said = 0, ""
        while not said:
            assert let_in <= rejoins
            bus = late(flight.client(ME))
            bus.begin.set()
            attacker = NodeClient(bus, RUN)
            try:
                attacker.join(Join("agent", 1, 3), Agent, 0.0 if let_in == rejoins else DEADLINE_S)
            except Refused as error:
                said = str(error)
            else:
                let_in += 1
                attacker.serve(lambda: False, lambda: False)  # until the world sends it home
            bus.close()
        assert let_in == rejoins
        assert verdict in said
        before = len(flight.held.sent)
        until(lambda: len(flight.held.sent) > before + 100, "the others fly on")
        flight.world.send_signal(signal.SIGINT)
        flight.world.communicate(timeout=DEADLINE_S)
        for thread in flight.crew:
            thread.join(DEADLINE_S)
