"""The leader node: averages once when a round closes, broadcasts in its coding, and names what it refuses.

The mean itself: tests/federation/test_two_levels.py. Frames that do not fit: tests/federation/test_misfits.py.
"""

import numpy as np
import pytest

from meanflock.federation.coding import Coding
from meanflock.federation.schedule import Schedule
from meanflock.leader.node import Leader
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from tests.agent.nodes import flown, frames, sense_of, welcome

LEADER = ("method=mfgfl-h", "federation.leader=3")


def closing(of: Scenario, number: int) -> int:
    return next(tick for tick in range(1000) if Schedule(of).closes(tick) == number)


def model(uav: int) -> np.ndarray:
    return np.random.default_rng(uav).standard_normal(108).astype(np.float32)


def upload(source: list[int], number: int = 1) -> Frames:
    links = [[row, 3] for row in range(len(source))]
    return frames(FrameKind.UPLOAD, source, [model(uav) for uav in source], links, number)


@pytest.mark.parametrize("rule", ["fedavg", "precision", "krum"])
def test_a_round_with_no_model_but_the_leader_s_own_is_void_and_changes_nothing(rule: str) -> None:
    of = flown(*LEADER, f'federation.aggregation="{rule}"')
    node, fresh = Leader(welcome(of, ())), Leader(welcome(of, ()))
    act = node.act(sense_of(closing(of, 1), (), upload([3])))
    assert (act.outbox, act.memory) == ((), b"")
    request = sense_of(closing(of, 2), (), upload([3, 5], number=2))
    assert wire.write_act(node.act(request)) == wire.write_act(fresh.act(request))


@pytest.mark.parametrize("down", ["int8", "float16", "float32"])
def test_a_leader_averages_what_bytes_stand_for_and_broadcasts_once_in_its_own_coding(down: str) -> None:
    of = flown(*LEADER, "federation.payload=int8", f"federation.broadcast_payload={down}")
    node, up = Leader(welcome(of, ())), Coding("int8", of.declared.parts)
    batch = upload([0, 1, 6])
    written = Frames(batch.kind, 1, batch.source, up.encode(batch.payload.astype(np.float64)), batch.links)
    act = node.act(sense_of(closing(of, 1), (), written))
    (sent,) = act.outbox
    heard = up.decode(written.payload)
    expected = Coding(down, of.declared.parts).encode(((heard[0] + heard[1]) + heard[2])[None] / 3)  # type: ignore[arg-type]
    assert (sent.kind, sent.round, sent.source.tolist(), sent.links) == (FrameKind.GLOBAL, 1, [3], None)
    assert (sent.payload.dtype, sent.payload.tobytes()) == (expected.dtype, expected.tobytes())
    assert isinstance(wire.read_act(wire.write_act(act)), Act)
    assert not node.act(sense_of(closing(of, 1) + 1, (), written)).outbox


def test_an_absurd_relay_is_refused_by_the_name_of_its_head() -> None:
    of = flown(*LEADER, "federation.clusters=3")
    relayed = [np.append(model(uav), count) for uav, count in ((0, 3), (6, 2))]
    batch = frames(FrameKind.RELAY, [0, 6], relayed, [[0, 3], [1, 3]])
    batch.payload[0, 5] = 1e10
    act = Leader(welcome(of, ())).act(sense_of(closing(of, 1), (), batch))
    assert act.refused.tolist() == [~0]
    np.testing.assert_array_equal(act.outbox[0].payload[0], model(6))
