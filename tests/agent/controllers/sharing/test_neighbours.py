"""What rows know of others: predicted from what was sent, the same for one row as for many, and said at events only."""

from typing import Any

import msgspec
import numpy as np
import pytest

from meanflock.agent.controllers.base import Broadcast, Memory, Received
from meanflock.agent.controllers.prediction import AlongPlan
from meanflock.agent.controllers.sharing.base import FAR_M, Neighbours
from meanflock.swarm import mission
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.scenario.tables import POLICIES, Sharing

N = 5
EVENT, TICK = Sharing(policy="event"), Sharing(policy="tick")
UAVS = np.arange(N)


def scenario(*settings: str) -> Scenario:
    return load(None, [f"uavs={N}", *settings])


def neighbours(sharing: Sharing, predict: Any = None, *settings: str) -> Neighbours:
    return Neighbours(msgspec.structs.replace(scenario(*settings), sharing=sharing), predict)


def plan(seed: int = 0) -> np.ndarray:
    draw = np.random.default_rng(seed)
    return np.concatenate([draw.normal(0, 10, (N, 2)), draw.normal(0, 1, (N, 2))], axis=1)


def frames(broadcast: Broadcast, rows: int, uavs: np.ndarray = UAVS, number: int = 0) -> Received:
    """What rows said, as it reaches every one of so many rows but the sender's own."""
    source = uavs if broadcast.rows is None else uavs[broadcast.rows]
    links = [[sent, row] for sent in range(len(source)) for row in range(rows) if uavs[row] != source[sent]]
    return Received(number, source, broadcast.payload, np.array(links, dtype=np.intp).reshape(-1, 2))


def test_at_take_off_everybody_is_where_the_mission_plan_says() -> None:
    for sharing in (EVENT, TICK):
        of = neighbours(sharing)
        memory = of.init(UAVS[:2], plan())
        np.testing.assert_array_equal(of.states(memory, 0), np.stack([plan(), plan()]))


def test_who_is_silent_goes_on_at_constant_velocity() -> None:
    of = neighbours(EVENT)
    known = of.states(of.init(UAVS, plan()), 30)
    expected = plan()
    expected[:, :2] += 3.0 * plan()[:, 2:]
    np.testing.assert_allclose(known, np.repeat(expected[None], N, axis=0), rtol=1e-15, atol=1e-13)


def test_along_a_plan_a_deviation_falls_to_a_part_in_e() -> None:
    def path(tick: int) -> np.ndarray:
        return np.outer(np.arange(1.0, N + 1), [0.1 * tick, 1.0, 1.0, 0.0])

    of = neighbours(EVENT, AlongPlan(path, 0.1, tau_s=2.0))
    start = path(0) + plan()
    memory = of.init(UAVS[3:4], start)
    np.testing.assert_allclose(of.states(memory, 0)[0], start, rtol=1e-15)
    np.testing.assert_allclose(of.states(memory, 20)[0], path(20) + plan() / np.e, rtol=0, atol=1e-13)
    np.testing.assert_allclose(of.states(memory, 100_000)[0], path(100_000), rtol=1e-15, atol=1e-15)


def test_a_broadcast_of_every_tick_reaches_who_is_in_range() -> None:
    of, now = neighbours(TICK), plan(1)
    memory = of.init(UAVS, plan())
    spoken, broadcast = of.speak(memory, 4, now)
    assert broadcast.rows is None
    received = frames(broadcast, N)
    kept = received.links[:, 1] != 2  # row 2 hears nobody
    partly = Received(0, received.source, received.payload, received.links[kept])
    known = of.states(of.receive(spoken, 5, [partly])[0], 5)
    expected = now.copy()
    expected[:, :2] += 0.1 * now[:, 2:]
    np.testing.assert_allclose(known[0], expected, rtol=1e-6)
    np.testing.assert_allclose(np.delete(known[2], 2, axis=0), np.delete(of.states(memory, 5)[2], 2, axis=0))
    np.testing.assert_allclose(known[2, 2], expected[2], rtol=1e-6)  # its own, as it said it


def test_one_silent_for_too_long_is_forgotten_where_everybody_should_speak() -> None:
    of = neighbours(Sharing(policy="tick", forget_s=1.0))
    memory = of.init(UAVS, plan())
    said, broadcast = of.speak(memory, 3, plan())
    memory, _ = of.receive(said, 4, [frames(Broadcast(broadcast.payload[:1], UAVS[:1]), N)])
    assert (np.abs(of.states(memory, 10)) < 1e3).all()
    known = of.states(memory, 11)
    assert (known[2, [1, 3, 4], :2] == FAR_M).all()
    assert not known[2, [1, 3, 4], 2:].any()
    assert (np.abs(known[2, 0]) < 1e3).all()


def test_an_event_is_a_position_that_others_predict_too_badly() -> None:
    of = neighbours(EVENT)
    memory = of.init(UAVS, plan())
    now = of.states(memory, 10)[0].copy()
    now[1, 0] += 0.29
    now[2, :2] += (-0.2, 0.25)  # 0.32 m
    now[3, 2:] += 5.0  # a velocity alone is no event
    after, broadcast = of.speak(memory, 10, now)
    assert broadcast.rows is not None
    assert broadcast.rows.tolist() == [2]
    assert broadcast.payload.dtype == np.int16
    assert broadcast.payload.shape == (1, 4)
    known = of.states(of.receive(after, 11, [frames(broadcast, N)])[0], 11)
    expected = now[2].copy()
    expected[:2] += 0.1 * now[2, 2:]
    np.testing.assert_allclose(known[:, 2], np.repeat(expected[None], N, axis=0), rtol=0, atol=0.0056)
    again, broadcast = of.speak(after, 11, np.where(UAVS[:, None] == 2, expected, of.states(after, 11)[0]))
    assert not len(broadcast.payload)
    assert again["neighbour_kept"].tobytes() == after["neighbour_kept"].tobytes()


def test_a_velocity_can_be_an_event_too() -> None:
    of = neighbours(Sharing(policy="event", velocity_delta_m_s=0.3))
    memory = of.init(UAVS, plan())
    now = of.states(memory, 10)[0].copy()
    now[1, 2:] += (0.2, -0.2)  # 0.28 m/s
    now[3, 2:] += (0.2, -0.25)
    assert of.speak(memory, 10, now)[1].rows.tolist() == [3]  # type: ignore[union-attr]


@pytest.mark.parametrize("repeats", [1, 2, 5])
def test_an_event_is_repeated_as_it_is_by_then(repeats: int) -> None:
    of = neighbours(Sharing(policy="event", repeats=repeats))
    memory, now = of.init(UAVS[:1], plan()), plan()[:1] + 1.0
    now[:, 2:] = 0.1, 0.0
    said = []
    for tick in range(1, 9):
        now = now + np.array([0.01, 0.0, 0.0, 0.0])
        memory, broadcast = of.speak(memory, tick, now)
        said.append(broadcast.payload[:, 0].tolist())
    assert [len(one) for one in said] == [1] * repeats + [0] * (8 - repeats)
    assert [one[0] - said[0][0] for one in said[:repeats]] == list(range(repeats))


def test_sender_and_receivers_predict_the_same_bits() -> None:
    of, other = neighbours(EVENT), neighbours(EVENT)
    mine, theirs = of.init(UAVS[:1], plan()), other.init(UAVS[4:], plan())
    draw, now = np.random.default_rng(3), plan()[:1]
    for tick in range(60):
        now = now + 0.2 * draw.standard_normal((1, 4))
        mine, broadcast = of.speak(mine, tick, now)
        received = Received(0, UAVS[:1][broadcast.rows], broadcast.payload, np.zeros((len(broadcast.payload), 2), int))
        theirs, _ = other.receive(theirs, tick + 1, [received] if len(broadcast.payload) else [])
        assert of.states(mine, tick + 1)[0, 0].tobytes() == other.states(theirs, tick + 1)[0, 0].tobytes()
        assert np.hypot(*(of.states(mine, tick)[0, 0, :2] - now[0, :2])) < 0.3 + 0.01


def test_a_state_beyond_16_bits_is_not_sent_but_counted() -> None:
    of = neighbours(EVENT, None, "start.centre=[100.0, 0.0]")
    memory = of.init(UAVS, plan())
    now, halfway = plan(), 0.5 * mission.starts(scenario("start.centre=[100.0, 0.0]"))[:, 0]
    now[:3, 0] = halfway[:3] + np.array([327.6, 327.8, -327.8])
    now[3, 3] = 400.0
    now[3, 0] += 1.0
    after, broadcast = of.speak(memory, 1, now)
    assert broadcast.rows is not None
    assert broadcast.rows.tolist() == [0]
    assert of.unsent(after).tolist() == [[0.0], [1.0], [1.0], [1.0], [0.0]]
    assert of.states(after, 1)[0, 0, 0] == pytest.approx(halfway[0] + 327.6, abs=0.005)
    assert of.states(after, 1)[0, 1, 0] < 100.0  # as all others still believe
    back, broadcast = of.speak(after, 2, plan())
    assert not of.unsent(back).any()


def test_a_lie_is_refused_and_named() -> None:
    for sharing, payload in (
        (TICK, np.array([[1e6, 0, 0, 0], [0, 0, 500.0, 0], [1.0, 2, 3, 4]])),
        (EVENT, np.array([[0, 0, 30_000, 0], [0, 0, 0, -32_768], [1, 2, 3, 4]], np.int16)),
    ):
        of = neighbours(sharing)
        memory = of.init(UAVS[:1], plan())
        said = Received(0, np.array([4, 2, 3]), payload, np.array([[0, 0], [1, 0], [2, 0]]))
        after, refused = of.receive(memory, 1, [said])
        assert refused.tolist() == [2, 4]
        assert not len(of.receive(memory, 1, [said], number=1)[1])
        known, before = of.states(after, 1), of.states(memory, 1)
        np.testing.assert_array_equal(known[0, [2, 4]], before[0, [2, 4]])
        assert (known[0, 3] != before[0, 3]).any()


@pytest.mark.parametrize(
    "payload",
    [np.ones((1, 4), np.float64), np.ones((1, 3), np.int16), np.ones((1, 4), np.int32), np.ones((1, 5), np.int16)],
)
def test_what_is_no_state_is_not_taken_for_one(payload: np.ndarray) -> None:
    of = neighbours(EVENT)
    memory = of.init(UAVS[:2], plan())
    after, _ = of.receive(memory, 1, [Received(0, UAVS[2:3], payload, np.array([[0, 0]]))])
    assert after["neighbour_kept"] is memory["neighbour_kept"]
    right = Received(1, UAVS[2:3], np.ones((1, 4), np.int16), np.array([[0, 0]]))
    assert of.receive(memory, 1, [right])[0]["neighbour_tick"] is memory["neighbour_tick"]
    assert (of.receive(memory, 3, [right], number=1)[0]["neighbour_tick"] == [[0, 0, 2, 0, 0], [0] * 5]).all()


@pytest.mark.parametrize("sharing", [EVENT, TICK, Sharing(repeats=3, delta_m=0.1)])
@pytest.mark.parametrize("along", [False, True])
def test_a_row_knows_the_same_alone_as_among_others(sharing: Sharing, along: bool) -> None:
    def path(tick: int) -> np.ndarray:
        return plan(9) + np.array([0.3 * tick, -0.1 * tick, 3.0, -1.0])

    def flown(groups: list[np.ndarray]) -> tuple[list[bytes], Memory]:
        all_of = [neighbours(sharing, AlongPlan(path, 0.1) if along else None) for _ in groups]
        memories = [of.init(group, plan()) for of, group in zip(all_of, groups, strict=True)]
        draw, now, seen = np.random.default_rng(2), plan(), []
        lost = draw.random((20, N, N)) < 0.3
        sent: list[Broadcast] = []
        for tick in range(20):
            now = now + 0.2 * draw.standard_normal((N, 4))
            received = [frames(broadcast, N) for broadcast in sent if len(broadcast.payload)]
            said, rows, known = [], [], []
            for k, (of, group) in enumerate(zip(all_of, groups, strict=True)):
                mine = []
                for batch in received:
                    through = ~lost[tick][batch.source[batch.links[:, 0]], batch.links[:, 1]]
                    links = batch.links[through & np.isin(batch.links[:, 1], group)]
                    links = np.stack([links[:, 0], np.searchsorted(group, links[:, 1])], axis=1)
                    mine.append(Received(0, batch.source, batch.payload, links))
                memories[k], _ = of.receive(memories[k], tick, mine)
                known.append(of.states(memories[k], tick))
                memories[k], broadcast = of.speak(memories[k], tick, now[group])
                said.append(broadcast.payload)
                rows.append(group if broadcast.rows is None else group[broadcast.rows])
            sent = [Broadcast(np.concatenate(said), np.concatenate(rows))]
            seen.append(np.concatenate(known).tobytes() + sent[0].payload.tobytes())
        return seen, {name: np.concatenate([one[name] for one in memories]) for name in memories[0]}

    together, memory = flown([UAVS])
    alone, memories = flown([UAVS[k : k + 1] for k in range(N)])
    assert together == alone
    assert all(memory[name].tobytes() == memories[name].tobytes() for name in memory)


def test_nothing_it_is_given_is_written_to() -> None:
    of = neighbours(EVENT)
    memory = of.init(UAVS, plan())
    after, broadcast = of.speak(memory, 1, plan(5))
    for array in (*memory.values(), *after.values(), broadcast.payload):
        array.flags.writeable = False
    of.speak(of.receive(after, 2, [frames(broadcast, N)])[0], 2, plan(6))


def test_alone_there_is_nobody_to_know_of() -> None:
    of = Neighbours(load(None, ["uavs=1"]))
    memory = of.init(UAVS[:1], plan()[:1])
    assert of.states(memory, 7).shape == (1, 1, 4)
    memory, broadcast = of.speak(memory, 7, plan(3)[:1])
    assert len(broadcast.payload) == 1
    none = of.init(UAVS[:0], plan()[:1])
    assert of.states(none, 7).shape == (0, 1, 4)
    assert of.speak(none, 7, np.zeros((0, 4)))[1].payload.shape == (0, 4)


def test_a_key_of_the_table_changes_one_thing_of_its_policy() -> None:
    assert Sharing().rule == POLICIES["event-4"] == ("event", 0.3, 0.2, 4)
    assert Sharing(policy="event").rule == ("event", 0.3, 0.0, 1)
    assert Sharing(policy="tick").rule.broadcast == "tick"
    assert Sharing(policy="event", delta_m=0.1, repeats=2).rule == ("event", 0.1, 0.0, 2)
    assert Sharing(velocity_delta_m_s=0.0).rule == ("event", 0.3, 0.0, 4)
