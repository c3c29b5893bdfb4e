"""The head of a cluster: what it keeps, what it hands on and when, and what it will not take."""

import numpy as np
import pytest

from meanflock.agent.heads import Heads
from meanflock.agent.node import Agent
from meanflock.swarm import scenario
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.mean import fedavg
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense, Welcome
from meanflock.swarm.wire.payload import Coding

NOBODY = np.zeros(0, dtype=np.intp)
OPENS, RELAYS = 10, 11  # of round 1


def flown(*settings: str) -> Scenario:
    """Clusters {0 1 2}, {3 4 5} and {6 7}; UAV 4 leads, so the heads are 0, 4 and 6."""
    fixed = ["uavs=8", "federation.period=10", "federation.clusters=3", "federation.leader=4"]
    return load(None, [*fixed, *settings], method="mfgfl-h")


def heads(*uavs: int, of: Scenario | None = None) -> Heads:
    return Heads(of or flown(), np.array(uavs, dtype=np.intp))


def model(uav: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng([uav, seed]).standard_normal(108).astype(np.float32)


def uploads(source: list[int], to: list[int], number: int = 1, seed: int = 0) -> Frames:
    payload = np.stack([model(uav, seed) for uav in source])
    links = np.array([[row, head] for row, head in enumerate(to)], dtype=np.int32).reshape(-1, 2)
    return Frames(FrameKind.UPLOAD, number, np.array(source, dtype=np.int32), payload, links)


def mean(*uavs: int) -> np.ndarray:
    return fedavg(np.stack([model(uav) for uav in uavs])).astype(np.float32)


def test_each_head_hands_on_its_own_mean_and_count_and_once() -> None:
    node = heads(0, 3, 4, 6)
    node.collect(uploads([0, 2, 3, 4], [0, 0, 4, 4]))
    node.collect(uploads([5], [4]))
    (said,), refused = node.relay(1, NOBODY)
    assert (said.kind, said.round, said.source.tolist(), refused) == (FrameKind.RELAY, 1, [0, 4], [])
    assert said.payload.dtype == np.float32
    np.testing.assert_array_equal(said.payload[:, -1], [2, 3])
    np.testing.assert_array_equal(said.payload[:, :-1], [mean(0, 2), mean(3, 4, 5)])
    assert node.relay(1, NOBODY) == ([], [])


def test_a_second_copy_changes_nothing_a_later_round_is_kept_and_an_older_is_forgotten() -> None:
    node = heads(0)
    node.collect(uploads([1, 2], [0, 0]))
    node.collect(uploads([1], [0], seed=9))
    node.collect(uploads([0], [0], number=2))
    (said,), _ = node.relay(1, NOBODY)
    np.testing.assert_array_equal(said.payload[0], np.append(mean(1, 2), 2))
    node.collect(uploads([1], [0]))  # too late for its round
    (said,), _ = node.relay(2, NOBODY)
    np.testing.assert_array_equal(said.payload[0], np.append(mean(0), 1))
    assert not node._arrived


def test_who_is_silent_hands_on_nothing_and_the_others_do() -> None:
    node = heads(0, 4)
    node.collect(uploads([1, 3], [0, 4]))
    (said,), _ = node.relay(1, np.array([0, 7]))
    assert said.source.tolist() == [4]
    assert not node._arrived


def test_absurd_models_are_refused_and_a_head_with_nothing_else_sends_nothing() -> None:
    node = heads(0, 6)
    batch = uploads([1, 2, 7], [0, 0, 6])
    batch.payload[[0, 2], 5] = 1e10
    node.collect(batch)
    (said,), refused = node.relay(1, NOBODY)
    assert (said.source.tolist(), refused) == ([0], [1, 7])
    np.testing.assert_array_equal(said.payload[0], np.append(mean(2), 1))


def test_a_mean_no_float_of_the_radio_can_hold_is_not_sent() -> None:
    of = flown("radio.bits_per_float=16", "federation.payload=int8")
    coding, node = Coding("int8", of.declared.parts), heads(0, 6, of=of)
    written = coding.encode(np.stack([np.full(108, 1e8), np.full(108, 2.0)]))
    links = np.array([[0, 0], [1, 6]], dtype=np.int32)
    node.collect(Frames(FrameKind.UPLOAD, 1, np.array([1, 7], np.int32), written, links))
    (said,), refused = node.relay(1, NOBODY)
    assert (said.source.tolist(), said.payload.dtype, refused) == ([6], np.float16, [])


MISFITS = {
    "to a UAV that heads nothing": uploads([4], [5]),
    "to another cluster's head": uploads([1], [4]),
    "of models too short": Frames(
        FrameKind.UPLOAD, 1, np.array([1], "<i4"), np.zeros((1, 107), "<f4"), np.array([[0, 0]], "<i4")
    ),
    "in doubles": Frames(FrameKind.UPLOAD, 1, np.array([1], "<i4"), np.zeros((1, 108)), np.array([[0, 0]], "<i4")),
}


@pytest.mark.parametrize("what", MISFITS)
def test_uploads_that_do_not_fit_are_rejected(what: str) -> None:
    node = heads(0, 4, 5, 6)
    node.check(uploads([1, 3, 7], [0, 4, 6]))
    with pytest.raises(MessageRejected):
        node.check(MISFITS[what])


@pytest.mark.parametrize("node", [heads(1, 2, 3), heads(0, 4, of=load(None, ["uavs=8"], method="mfgfl-h"))])
def test_who_heads_nothing_hears_no_uploads(node: Heads) -> None:
    with pytest.raises(MessageRejected, match="wrong-kind"):
        node.check(uploads([1], [0]))


# -- as a part of the node ----------------------------------------------------------------------------------------


def agent(*uavs: int) -> Agent:
    of = flown()
    return Agent(Welcome(0, "agent", uavs, 0, scenario.encode(of), starts(of).astype(np.float32)))


def sense(tick: int, rows: int, *inbox: Frames) -> Sense:
    return Sense(0, tick, np.random.default_rng(tick).uniform(0, 100, (rows, 4)), True, False, inbox)


def test_an_agent_hands_on_what_its_heads_heard_and_learns_as_if_it_had_not() -> None:
    busy, idle = agent(0, 1), agent(0, 1)
    batch = uploads([1, 2], [0, 0])
    batch.payload[1, 0] = 2e9
    for tick in (OPENS, RELAYS):
        inbox = (batch,) if tick == RELAYS else ()
        acts = busy.act(sense(tick, 2, *inbox)), idle.act(sense(tick, 2))
        assert (FrameKind.RELAY in [frames.kind for frames in acts[0].outbox]) == (tick == RELAYS)
    assert [frames.kind for frames in acts[0].outbox] == [FrameKind.RELAY]
    assert acts[0].outbox[0].payload[0, -1] == 1
    assert acts[0].refused.tolist() == [~2]
    assert acts[1].outbox == ()
    np.testing.assert_array_equal(acts[0].models, acts[1].models)  # type: ignore[arg-type]
    assert isinstance(wire.read_act(wire.write_act(acts[0])), Act)


def test_an_agent_whose_sense_does_not_fit_keeps_none_of_its_uploads() -> None:
    node = agent(0, 1)
    node.act(sense(OPENS, 2))
    with pytest.raises(MessageRejected):
        node.act(sense(RELAYS, 2, uploads([1], [0]), uploads([4], [1])))
    assert node.act(sense(RELAYS, 2)).outbox == ()
