"""Taking part in a run: a node that is told to leave while it still looks for the world leaves, and nothing failed."""

from typing import ClassVar

import pytest

from meanflock.agent.node import Agent
from meanflock.swarm.errors import BusError, Refused, WorldGone
from meanflock.swarm.net import client
from meanflock.swarm.net.bus import Bus, MemoryNetwork
from meanflock.swarm.net.client import take_part
from meanflock.swarm.wire.messages import Join, Stop


def nowhere(timeout_s: float) -> Bus:
    raise BusError("cannot open a session")


@pytest.mark.parametrize("connect", [nowhere, lambda _timeout_s: MemoryNetwork().endpoint()])
def test_who_is_told_to_leave_before_there_is_a_world_leaves(connect) -> None:
    assert take_part(connect, "r", Join("agent", 1), Agent, 60.0, lambda: True, lambda: False) == "interrupted"


def test_who_finds_no_world_in_time_says_so() -> None:
    with pytest.raises(BusError, match="cannot open a session"):
        take_part(nowhere, "r", Join("agent", 1), Agent, 0.0, lambda: False, lambda: False)


class Comer:
    """A `NodeClient` that is let in `times` times, loses its session each time, and is refused from then on, in words
    that say nothing."""

    times = 0

    def __init__(self, bus: Bus, run: str) -> None:
        pass

    def join(self, *_: object) -> None:
        if not Comer.times:
            raise Refused("the world refused: no", over=True)
        Comer.times -= 1

    def serve(self, *_: object) -> str:
        raise WorldGone("gone")


@pytest.mark.parametrize("times", [0, 1, 2])
def test_who_lost_its_session_and_comes_back_after_the_last_tick_goes_home_and_who_never_flew_is_refused(
    times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "NodeClient", Comer)
    Comer.times = times

    def part() -> str:
        network = MemoryNetwork()
        return take_part(lambda _: network.endpoint(), "r", Join("agent", 1), Agent, 60.0, lambda: False, lambda: False)

    if times:
        assert part() == "the world refused: no"
    else:
        with pytest.raises(Refused):
            part()


class Sent(Comer):
    """A `NodeClient` that the world sends home each time."""

    stops: ClassVar[list[Stop]] = []

    def join(self, *_: object) -> None:
        pass

    def serve(self, *_: object) -> str:
        self.stopped = Sent.stops.pop(0)
        return self.stopped.reason


def test_who_is_taken_for_lost_joins_again_whatever_the_words_and_who_is_sent_home_goes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(client, "NodeClient", Sent)
    Sent.stops = [Stop(1, "for a reason", lost=True), Stop(1, "lost: and found"), Stop(1, "never heard")]
    network = MemoryNetwork()
    why = take_part(lambda _: network.endpoint(), "r", Join("agent", 1), Agent, 60.0, lambda: False, lambda: False)
    assert why == "lost: and found"
