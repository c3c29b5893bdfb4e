"""Taking part in a run: a node that is told to leave while it still looks for the world leaves, and nothing failed."""

import pytest

from meanflock.agent.node import Agent
from meanflock.swarm.errors import BusError
from meanflock.swarm.net.attendance import take_part
from meanflock.swarm.net.bus import Bus, MemoryNetwork
from meanflock.swarm.wire.messages import Join


def nowhere(timeout_s: float) -> Bus:
    raise BusError("cannot open a session")


@pytest.mark.parametrize("connect", [nowhere, lambda _timeout_s: MemoryNetwork().endpoint()])
def test_who_is_told_to_leave_before_there_is_a_world_leaves(connect) -> None:
    assert take_part(connect, "r", Join("agent", 1), Agent, 60.0, lambda: True, lambda: False) == "interrupted"


def test_who_finds_no_world_in_time_says_so() -> None:
    with pytest.raises(BusError, match="cannot open a session"):
        take_part(nowhere, "r", Join("agent", 1), Agent, 0.0, lambda: False, lambda: False)
