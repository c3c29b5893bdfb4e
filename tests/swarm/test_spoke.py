"""A node on its way in: it asks until it is answered, and asks for one place only."""

import numpy as np
import pytest

from swarm import codec, keys, scenario
from swarm.bus import MemoryNetwork
from swarm.errors import BusError
from swarm.messages import Act, Join, Sense, Welcome
from swarm.spoke import Spoke

RUN = "deaf"


class Idle:
    """A mind without thoughts."""

    def __init__(self, welcome: Welcome) -> None:
        self.welcome = welcome

    def act(self, sense: Sense) -> Act:
        raise NotImplementedError


def test_a_join_whose_answer_is_lost_is_repeated_with_the_same_token(monkeypatch: pytest.MonkeyPatch) -> None:
    network = MemoryNetwork()
    flown = scenario.load(None, uavs=1)
    welcome = Welcome(
        keys.fingerprint(RUN), "agent-0", (0,), 0, scenario.encode(flown), np.zeros((1, 4), dtype=np.float32)
    )
    asked: list[bytes] = []

    def ask(_key: str, raw: bytes, _timeout_s: float) -> bytes | None:
        asked.append(raw)
        return codec.encode(welcome) if len(asked) == 3 else None

    tokens = set()
    for _ in range(2):
        asked.clear()
        bus = network.endpoint()
        monkeypatch.setattr(bus, "ask", ask)
        assert Spoke(bus, RUN).join(Join("agent", 1), Idle, timeout_s=60.0).node == "agent-0"
        assert len(asked) == 3
        assert len(set(asked)) == 1
        join = codec.decode(asked[0])
        assert isinstance(join, Join)
        tokens.add(join.token)
    assert len(tokens - {0}) == 2  # every node its own


def test_a_world_that_never_answers_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = MemoryNetwork().endpoint()
    monkeypatch.setattr(bus, "ask", lambda *_: None)
    with pytest.raises(BusError, match="no world of run 'deaf'"):
        Spoke(bus, RUN).join(Join("agent", 1), Idle, timeout_s=0.0)
