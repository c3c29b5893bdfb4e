"""Contract of frames that do not fit: node × misfit → the request is rejected by its reader or the node, and nothing of
it is kept.

Requests of other layouts: tests/faults/test_hostile_input.py.
"""

from typing import Any, NamedTuple

import numpy as np
import pytest

from meanflock.agent.node import Agent
from meanflock.leader.node import Leader
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.messages import FrameKind, Frames
from tests.agent.nodes import flown, frames, sense_of, welcome

UPLOAD, RELAY, GLOBAL, STATE = FrameKind.UPLOAD, FrameKind.RELAY, FrameKind.GLOBAL, FrameKind.STATE
# Eight UAVs; with heads the clusters are {0 1 2}, {3 4 5} and {6 7}, led by 0, 4 and 6, and 4 leads all.
HEADS = ("federation.clusters=3", "federation.leader=4")


def of(kind: FrameKind, width: int, source: list[int], links: Any, dtype: str = "<f4", last: float = 0.0) -> Frames:
    """Models of zeros but for their last number."""
    payload = np.zeros((len(source), width), dtype)
    payload[:, -1] = last
    batch = frames(kind, source, payload, links)
    return Frames(kind, int(kind != STATE), batch.source, payload, batch.links)


def relay(source: int, count: float, dtype: str = "<f4", width: int = 109) -> Frames:
    return of(RELAY, width, [source], [[0, 4]], dtype, count)


class Node(NamedTuple):
    """Settings of the flight, a tick in which frames arrive, the node's UAVs (none: the leader), and the frames."""

    settings: tuple[str, ...]
    tick: int
    uavs: tuple[int, ...]
    fitting: tuple[Frames, ...]
    misfits: dict[str, Frames]


MODELS: dict[str, Frames] = {  # of a flat federation of 108 floats, for an agent of the UAVs 2, 3 and 5
    "an upload": of(UPLOAD, 108, [0], [[0, 2]]),
    "a relay": of(RELAY, 109, [0], [[0, 2]]),
    "no links": of(GLOBAL, 108, [0], None),
    "too short": of(GLOBAL, 107, [0], [[0, 2]]),
    "to a UAV of another node": of(GLOBAL, 108, [0], [[0, 4]]),
    "to a UAV that is nowhere": of(GLOBAL, 108, [0], [[0, 99]]),
    "of a UAV that is nowhere": of(GLOBAL, 108, [8], [[0, 2]]),
    "of a UAV below zero": of(GLOBAL, 108, [-1], [[0, 2]]),
    "a link beyond the models": of(GLOBAL, 108, [0], [[1, 2]]),
    "a link below zero": of(GLOBAL, 108, [0], [[-1, 2]]),
    "in doubles": of(GLOBAL, 108, [0], [[0, 2]], "<f8"),
}
UPLOADS: dict[str, Frames] = {
    "a global model": of(GLOBAL, 108, [0, 1], [[0, 0], [1, 0]]),
    "a state": of(STATE, 108, [0, 1], [[0, 0], [1, 0]]),
    "too short": of(UPLOAD, 107, [0, 1], [[0, 0], [1, 0]]),
    "in doubles": of(UPLOAD, 108, [0, 1], [[0, 0], [1, 0]], "<f8"),
    "a relay without heads": relay(3, 2.0),
}
RELAYS: dict[str, Frames] = {
    "an upload": of(UPLOAD, 108, [0, 1], [[0, 4], [1, 4]]),
    "of no model": relay(0, 0.0),
    "of half a model": relay(0, 1.5),
    "of more models than the cluster has": relay(0, 4.0),
    "of fewer than none": relay(4, -1.0),
    "of infinitely many": relay(4, np.inf),
    "of a count that is no number": relay(4, np.nan),
    "of no head": relay(5, 2.0),
    "of a UAV that is nowhere": relay(99, 2.0),
    "of a UAV below zero": relay(-1, 2.0),
    "without a count": relay(0, 2.0, width=108),
    "in doubles": relay(0, 2.0, "<f8"),
}
TO_HEADS: dict[str, Frames] = {
    "to a UAV that heads nothing": of(UPLOAD, 108, [4], [[0, 5]]),
    "to another cluster": of(UPLOAD, 108, [1], [[0, 4]]),
    "too short": of(UPLOAD, 107, [1], [[0, 0]]),
    "in doubles": of(UPLOAD, 108, [1], [[0, 0]], "<f8"),
}
BYTES = {  # 108 steps and two scales
    "floats": of(UPLOAD, 108, [1], [[0, 0]]),
    "floats of as many columns": of(UPLOAD, 116, [1], [[0, 0]]),
    "no scales": of(UPLOAD, 108, [1], [[0, 0]], "u1"),
    "a byte too few": of(UPLOAD, 115, [1], [[0, 0]], "u1"),
}
TO_ALL = [[0, 2], [0, 3], [0, 5]]
NODES = {
    "agent": Node((), 7, (2, 3, 5), (of(GLOBAL, 108, [0], TO_ALL, last=1.0),), MODELS),
    "agent that hears states": Node(
        ("method=hjb",), 1, (2, 3, 5), (of(STATE, 4, [0], TO_ALL),), {"a bad link": of(STATE, 4, [0], [[1, 2]])}
    ),
    "leader": Node((), 6, (), (of(UPLOAD, 108, [7], [[0, 0]]),), UPLOADS),
    "leader of int8": Node(("federation.payload=int8",), 6, (), (), BYTES),
    "leader of doubles": Node(("radio.bits_per_float=64",), 6, (), (), {"floats": of(UPLOAD, 108, [1], [[0, 0]])}),
    "leader of heads": Node(HEADS, 7, (), (relay(6, 2.0),), RELAYS),
    "heads": Node(HEADS, 6, (0, 4, 5, 6), (of(UPLOAD, 108, [1, 3, 7], [[0, 0], [1, 4], [2, 6]]),), TO_HEADS),
    "no head": Node(HEADS, 6, (1, 2, 3), (), {"an upload": of(UPLOAD, 108, [1], [[0, 0]])}),
    "no clusters": Node((), 6, (0, 4), (), {"an upload": of(UPLOAD, 108, [1], [[0, 0]])}),
}
CASES = [(name, misfit) for name, node in NODES.items() for misfit in node.misfits]


@pytest.mark.parametrize(("name", "misfit"), CASES)
def test_a_request_with_a_frame_that_does_not_fit_is_rejected_and_nothing_has_changed(name: str, misfit: str) -> None:
    settings, tick, uavs, fitting, misfits = NODES[name]
    flight = flown("method=mfgfl-h", *settings)
    node, untouched, other = (Agent(welcome(flight, uavs)) if uavs else Leader(welcome(flight, ())) for _ in range(3))
    with pytest.raises(MessageRejected):
        node.act(wire.read_sense(wire.write_sense(sense_of(tick, uavs, *fitting, misfits[misfit])), uavs=flight.uavs))
    replies = [wire.write_act(one.act(sense_of(tick, uavs))) for one in (node, untouched)]
    assert replies[0] == replies[1]
    if fitting:
        assert wire.write_act(other.act(sense_of(tick, uavs, *fitting))) != replies[0]
