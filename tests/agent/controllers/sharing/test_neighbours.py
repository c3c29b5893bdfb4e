"""What a UAV knows of the others: predictions from received states; and when states are sent."""

import msgspec
import numpy as np
import pytest

from meanflock.agent.controllers.base import Broadcast, Received
from meanflock.agent.controllers.sharing.base import FAR_M, Neighbours
from meanflock.swarm.scenario import load
from meanflock.swarm.scenario.tables import POLICIES, Sharing

N = 5
EVENT = Sharing(policy="event")
UAVS = np.arange(N)


def neighbours(sharing: Sharing) -> Neighbours:
    return Neighbours(msgspec.structs.replace(load(None, [f"uavs={N}"]), sharing=sharing))


def plan(seed: int = 0) -> np.ndarray:
    draw = np.random.default_rng(seed)
    return np.concatenate([draw.normal(0, 10, (N, 2)), draw.normal(0, 1, (N, 2))], axis=1)


def frames(broadcast: Broadcast, rows: int, uavs: np.ndarray = UAVS, number: int = 0) -> Received:
    """A broadcast as it reaches all rows but the sender's own."""
    source = uavs if broadcast.rows is None else uavs[broadcast.rows]
    links = [[sent, row] for sent in range(len(source)) for row in range(rows) if uavs[row] != source[sent]]
    return Received(number, source, broadcast.payload, np.array(links, dtype=np.intp).reshape(-1, 2))


def test_with_a_state_every_tick_a_uav_not_received_for_long_is_forgotten() -> None:
    table = neighbours(Sharing(policy="tick", forget_s=1.0))
    memory = table.init(UAVS, plan())
    said, broadcast = table.broadcast_states(memory, 3, plan())
    memory, _ = table.receive(said, 4, [frames(Broadcast(broadcast.payload[:1], UAVS[:1]), N)])
    assert (np.abs(table.states(memory, 10)) < 1e3).all()
    known = table.states(memory, 11)
    assert (known[2, [1, 3, 4], :2] == FAR_M).all()
    assert not known[2, [1, 3, 4], 2:].any()
    assert (np.abs(known[2, 0]) < 1e3).all()


def test_a_state_is_sent_when_others_predict_its_position_too_badly() -> None:
    table = neighbours(EVENT)
    memory = table.init(UAVS, plan())
    now = table.states(memory, 10)[0].copy()
    now[1, 0] += 0.29
    now[2, :2] += (-0.2, 0.25)  # 0.32 m
    now[3, 2:] += (0.2, -0.25)  # a velocity alone is an event only where one is asked for
    now[4, 2:] += (0.2, -0.2)  # 0.28 m/s
    after, broadcast = table.broadcast_states(memory, 10, now)
    assert broadcast.rows is not None
    assert broadcast.rows.tolist() == [2]
    assert broadcast.payload.dtype == np.int16
    assert broadcast.payload.shape == (1, 4)
    known = table.states(table.receive(after, 11, [frames(broadcast, N)])[0], 11)
    expected = now[2].copy()
    expected[:2] += 0.1 * now[2, 2:]
    np.testing.assert_allclose(known[:, 2], np.repeat(expected[None], N, axis=0), rtol=0, atol=0.0056)
    also = neighbours(Sharing(policy="event", velocity_delta_m_s=0.3))
    assert also.broadcast_states(also.init(UAVS, plan()), 10, now)[1].rows.tolist() == [2, 3]  # type: ignore[union-attr]
    again, broadcast = table.broadcast_states(
        after, 11, np.where(UAVS[:, None] == 2, expected, table.states(after, 11)[0])
    )
    assert not len(broadcast.payload)
    assert again["neighbour_remembered"].tobytes() == after["neighbour_remembered"].tobytes()


@pytest.mark.parametrize(
    "payload",
    [np.ones((1, 4), np.float64), np.ones((1, 3), np.int16), np.ones((1, 4), np.int32), np.ones((1, 5), np.int16)],
)
def test_a_payload_of_another_type_or_width_is_no_state(payload: np.ndarray) -> None:
    table = neighbours(EVENT)
    memory = table.init(UAVS[:2], plan())
    after, _ = table.receive(memory, 1, [Received(0, UAVS[2:3], payload, np.array([[0, 0]]))])
    assert after["neighbour_remembered"] is memory["neighbour_remembered"]
    right = Received(1, UAVS[2:3], np.ones((1, 4), np.int16), np.array([[0, 0]]))
    assert table.receive(memory, 1, [right])[0]["neighbour_tick"] is memory["neighbour_tick"]
    assert (table.receive(memory, 3, [right], number=1)[0]["neighbour_tick"] == [[0, 0, 2, 0, 0], [0] * 5]).all()


def test_a_key_of_the_table_changes_one_part_of_its_policy() -> None:
    assert Sharing().rule == POLICIES["event-4"] == ("event", 0.3, 0.2, 4)
    assert Sharing(policy="event").rule == ("event", 0.3, 0.0, 1)
    assert Sharing(policy="tick").rule.broadcast == "tick"
    assert Sharing(policy="event", delta_m=0.1, repeats=2).rule == ("event", 0.1, 0.0, 2)
    assert Sharing(velocity_delta_m_s=0.0).rule == ("event", 0.3, 0.0, 4)
