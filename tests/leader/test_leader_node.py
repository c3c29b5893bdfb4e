"""The leader node: collects a round's uploads, averages once when the round closes, and broadcasts the result."""

import numpy as np
import pytest

from meanflock.federation.coding import Coding
from meanflock.federation.schedule import Schedule
from meanflock.leader.node import Leader
from meanflock.swarm import scenario
from meanflock.swarm.mission import starts
from meanflock.swarm.net import keys
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense, Welcome

RUN = keys.fingerprint("leader-test")
PERIOD = 10


def flown(*settings: str, method: str = "mfgfl-h") -> Scenario:
    return load(None, ["uavs=8", f"federation.period={PERIOD}", "federation.leader=3", *settings], method=method)


def leader(of: Scenario) -> Leader:
    return Leader(Welcome(RUN, "leader", (), 0, scenario.encode(of), starts(of).astype(np.float32)))


def sense(tick: int, *inbox: Frames) -> Sense:
    return Sense(RUN, tick, np.zeros((0, 4)), False, False, inbox)


def upload(source: list[int], number: int = 1, floats: int = 108, seed: int = 0) -> Frames:
    payload = np.stack([model_of(uav, seed)[:floats] for uav in source])
    links = np.array([[row, 3] for row in range(len(source))], dtype=np.int32)
    return Frames(FrameKind.UPLOAD, number, np.array(source, dtype=np.int32), payload, links)


def model_of(uav: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng([uav, seed]).standard_normal(246).astype(np.float32)


def said(act: Act) -> list[tuple[FrameKind, int, list[int]]]:
    return [(batch.kind, batch.round, batch.source.tolist()) for batch in act.outbox]


def closing(of: Scenario, number: int) -> int:
    return next(t for t in range(1000) if Schedule(of).closes(t) == number)


@pytest.mark.parametrize("rule", ["fedavg", "precision", "krum"])
def test_a_round_with_no_model_but_the_leader_s_own_is_void_and_changes_nothing(rule: str) -> None:
    of = flown(f'federation.aggregation="{rule}"')
    node, fresh = leader(of), leader(of)
    act = node.act(sense(closing(of, 1), upload([3])))
    assert (said(act), act.memory) == ([], b"")
    both = upload([3, 5], number=2)
    assert node.act(sense(closing(of, 2), both)).memory == fresh.act(sense(closing(of, 2), both)).memory


@pytest.mark.parametrize("down", ["int8", "float16", "float32"])
def test_a_leader_averages_what_bytes_stand_for_and_broadcasts_in_its_own_coding(down: str) -> None:
    of = flown("federation.payload=int8", f"federation.broadcast_payload={down}")
    node, up = leader(of), Coding("int8", of.declared.parts)
    batch = upload([0, 1, 6])
    written = Frames(batch.kind, 1, batch.source, up.encode(batch.payload.astype(np.float64)), batch.links)
    sent = node.act(sense(closing(of, 1), written)).outbox[0]
    heard = up.decode(written.payload)
    mean = ((heard[0] + heard[1]) + heard[2]) / 3
    expected = Coding(down, of.declared.parts).encode(mean[None])  # type: ignore[arg-type]
    assert (sent.payload.dtype, sent.payload.tobytes()) == (expected.dtype, expected.tobytes())


def relayed(counts: dict[int, int], number: int = 1) -> Frames:
    """Of heads 0, 3 (the leader's) and 6: the mean is the model of the head."""
    source = np.array(sorted(counts), dtype=np.int32)
    payload = np.stack([np.append(model_of(uav)[:108], np.float32(counts[uav])) for uav in sorted(counts)])
    return Frames(FrameKind.RELAY, number, source, payload, np.array([[row, 3] for row in range(len(source))], "<i4"))


def test_an_absurd_relay_is_refused_by_the_name_of_its_head() -> None:
    of = flown("federation.clusters=3")
    node, batch = leader(of), relayed({0: 3, 6: 2})
    batch.payload[0, 5] = 1e10
    act = node.act(sense(closing(of, 1), batch))
    assert act.refused.tolist() == [~0]
    np.testing.assert_array_equal(act.outbox[0].payload[0], model_of(6)[:108])
