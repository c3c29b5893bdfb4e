"""Contract of the controllers and filters that share states: when these are sent and used, and how they fly by them."""

import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.base import Broadcast, Received
from meanflock.agent.controllers.sharing.base import Neighbours
from meanflock.swarm import mission
from meanflock.swarm.scenario import load
from meanflock.swarm.scenario.tables import POLICIES, Sharing
from tests.agent.controllers.by_hand import made, stepped

METHODS = ("vasarhelyi", "olfati-saber", "potential-field", "orca", "bvc")
BEHIND = {kind: ("cruise", f"filter.kind={kind}") for kind in ("ecbf", "braking")}
SUBJECTS: dict[str, tuple[str, ...]] = {**{method: (method,) for method in METHODS}, **BEHIND}
STATES = np.array([[70.0, 0.0, 0, 0], [71.0, 0.0, 0, 0], [70.0, 30.0, 0, 0]])
each = pytest.mark.parametrize("subject", SUBJECTS.values(), ids=SUBJECTS)


@each
def test_a_received_state_moves_its_receiver_and_a_false_one_is_named_and_not_used(subject: tuple[str, ...]) -> None:
    controller = made(*subject, "sharing.policy=tick", "sharing.forget_s=2", uavs=3)
    memory = controller.init(np.arange(3), STATES)
    said = [[70.3, 0.4, 0, 0], [70.3, 0.4, 300, 0], [1e30, 0, 0, 0]]
    true, *false = (Received(0, np.array([2]), np.array([state]), np.array([[0, 0]])) for state in said)
    heard = ([], [true], *([one] for one in false))
    alone, pushed, *fooled = (controller.step(memory, 1, STATES, received) for received in heard)
    assert np.hypot(*(pushed.acceleration - alone.acceleration)[0]) > 0.01
    assert pushed.acceleration[1:].tobytes() == alone.acceleration[1:].tobytes()
    assert not len(pushed.refused)
    for step in fooled:
        assert step.acceleration.tobytes() == alone.acceleration.tobytes()
        assert step.refused.tolist() == [2]
    later = [controller.step(pushed.memory, tick, STATES, ()).acceleration for tick in (19, 23)]
    assert np.hypot(*(later[0] - later[1])[0]) > 0.01  # a UAV that was not received for long is not avoided


@each
def test_a_state_beyond_16_bits_is_not_sent_and_counted(subject: tuple[str, ...]) -> None:
    controller = made(*subject, uavs=3)
    memory = controller.init(np.arange(3), STATES)
    halfway = 0.5 * mission.starts(controller.scenario)[:, :1]
    far = np.concatenate([halfway + np.array([[327.6], [327.8], [-327.8]]), np.zeros((3, 3))], axis=1)
    fast = STATES + np.array([0, 0, 0, 400.0])
    for moved, sent, counted in ((far, [0], [0.0, 1.0, 1.0]), (fast, [], [1.0, 1.0, 1.0])):
        step = controller.step(memory, 1, moved, ())
        assert step.diagnostics[:, -1].tolist() == counted
        assert step.broadcasts[0].rows.tolist() == sent
    assert not controller.step(step.memory, 2, STATES, ()).diagnostics[:, -1].any()


@each
def test_two_uavs_in_one_place_come_apart(subject: tuple[str, ...]) -> None:
    step = stepped(made(*subject), np.array([[70.0, 0.0, 0, 0], [70.0, 0.0, 0, 0]]))
    assert np.isfinite(step.acceleration).all()
    if subject != ("olfati-saber",):  # whose force vanishes there
        assert step.acceleration[0, 0] < step.acceleration[1, 0] - 1.0


@pytest.mark.parametrize(("method", "mean_s"), [("vasarhelyi", 82.0), ("olfati-saber", 110.0), ("orca", 82.0)])
def test_the_swarm_arrives_without_a_collision_and_events_take_a_tenth_of_the_bits(method: str, mean_s: float) -> None:
    runs = [
        mf.fly("paper", method=method, seed=4, **{"sharing.policy": policy}).summary for policy in ("tick", "event")
    ]
    for summary in runs:
        assert (summary["collisions_all"], summary["arrived"]) == (0, 25)
        assert summary["t_avg_s"] < mean_s
    every_tick, events = (summary["payload_bits"]["state"] for summary in runs)
    assert events < 0.1 * every_tick


@pytest.mark.parametrize(("method", "limit"), [("orca", None), ("bvc", 6.0)])
def test_a_swap_through_one_point_ends_without_a_collision_and_needs_a_rule_of_the_road(
    method: str, limit: float | None
) -> None:
    swap = {"uavs": 16, "start.radius": 10.0, "vehicle.acceleration_max": limit, "duration": 60}
    run = mf.fly("swap", method=method, seed=5, **swap).summary
    assert (run["collisions_all"], run["arrived"], run["lost"]) == (0, 16, 0)
    without = mf.fly("swap", method=method, seed=5, **swap, **{"controller.right_bias": 0.0}).summary
    assert without["t_max_s"] is None or without["t_max_s"] > run["t_max_s"]


@pytest.mark.parametrize(("subject", "hits"), [*((subject, 0) for subject in SUBJECTS), ("cruise", 2)])
def test_a_uav_alone_arrives_round_discs_that_lie_in_its_way(subject: str, hits: int) -> None:
    discs = [{"centre": [75.0, 50.3], "radius": 3.0}, {"centre": [40.0, 26.0], "radius": 2.0}]
    method = {"method": "cruise", "filter.kind": subject} if subject in BEHIND else {"method": subject}
    summary = mf.fly("paper", uavs=1, seed=1, obstacles=discs, duration=120, **method).summary
    assert (summary["obstacle_hits"], summary["arrived"]) == (hits, 1)
    assert summary["radio"]["traffic"]["state"]["sent"] == 0


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


def test_a_state_is_sent_when_others_predict_its_position_too_badly() -> None:
    table = neighbours(EVENT)
    memory = table.init(UAVS, plan())
    now = table.states(memory, 10)[0].copy()
    now[1, 0] += 0.29
    now[2, :2] += (-0.2, 0.25)  # 0.32 m
    now[3, 2:] += (0.2, -0.25)  # a velocity alone is an event only where one is asked for
    now[4, 2:] += (0.2, -0.2)  # 0.28 m/s
    after, broadcast = table.broadcast_states(memory, 10, now)
    assert broadcast.rows.tolist() == [2]
    assert broadcast.payload.dtype == np.int16
    assert broadcast.payload.shape == (1, 4)
    predicted = table.states(table.receive(after, 11, [frames(broadcast, N)])[0], 11)
    expected = now[2].copy()
    expected[:2] += 0.1 * now[2, 2:]
    np.testing.assert_allclose(predicted[:, 2], np.repeat(expected[None], N, axis=0), rtol=0, atol=0.0056)
    also = neighbours(Sharing(policy="event", velocity_delta_m_s=0.3))
    assert also.broadcast_states(also.init(UAVS, plan()), 10, now)[1].rows.tolist() == [2, 3]
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
