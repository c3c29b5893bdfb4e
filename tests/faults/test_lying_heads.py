"""Heads that lie, and nodes that speak where they have nothing to say: dropped, counted, and nobody else notices."""

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from meanflock.federation.schedule import Schedule
from meanflock.swarm.wire import tick
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from tests.faults.clusters import CLEAR, FLOATS, PERIOD, globals_of, swarm
from tests.faults.conftest import Lab
from tests.swarm.examples import read


def saying(lab: Lab, name: str, change: Callable[[Frames], Frames | None], kind: FrameKind) -> None:
    """From now on a node says `change` of its frames of a kind, before or instead of them."""
    client: Any = lab.bus_of(name).handler.__self__  # type: ignore[union-attr]
    put = client._bus.put

    def speak(key: str, raw: bytes) -> None:
        act = read(raw)
        if isinstance(act, Act) and (found := [frames for frames in act.outbox if frames.kind == kind]):
            put(key, tick.write_act(Act(act.run, act.tick, act.commands, outbox=(change(found[0]),))))  # type: ignore[arg-type]
        put(key, raw)

    client._bus.put = speak


def counted(frames: Frames, count: float) -> Frames:
    payload = frames.payload.copy()
    payload[0, -1] = count
    return Frames(frames.kind, frames.round, frames.source, payload)


HOSTILE: dict[str, tuple[Callable[[Frames], Frames], str]] = {
    "of more models than its cluster has": (lambda f: counted(f, 5.0), "wrong-shape"),
    "of half a model": (lambda f: counted(f, 0.5), "wrong-shape"),
    "of no model": (lambda f: counted(f, 0.0), "wrong-shape"),
    "without a count": (lambda f: Frames(f.kind, f.round, f.source, f.payload[:, :-1]), "wrong-shape"),
    "in doubles": (lambda f: Frames(f.kind, f.round, f.source, f.payload.astype("<f8")), "wrong-shape"),
    "of another head": (lambda f: Frames(f.kind, f.round, f.source + 4, f.payload), "wrong-shape"),
    "of a UAV that heads nothing": (lambda f: Frames(f.kind, f.round, f.source + 1, f.payload), "wrong-shape"),
    "with links": (
        lambda f: Frames(f.kind, f.round, f.source, f.payload, np.zeros((1, 2), np.int32)),
        "wrong-shape",
    ),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_relay_that_cannot_be_is_dropped_and_counted_and_the_flight_is_as_if_it_had_not_come(what: str) -> None:
    change, reason = HOSTILE[what]
    expected = Lab(swarm(), uavs_per_node=1).fly()
    lab = Lab(swarm(), uavs_per_node=1)
    saying(lab, "agent-4", change, FrameKind.RELAY)
    summary = lab.fly()
    assert summary["dropped_messages"] == {reason: 5}
    assert summary["trajectory_sha256"] == expected["trajectory_sha256"]


def test_relays_are_for_heads_rounds_and_scenarios_that_have_them() -> None:
    """From who heads nothing, between the rounds, and where there are no clusters."""
    model = np.ones((1, FLOATS + 1), np.float32)

    def extra(lab: Lab, name: str, uav: int) -> dict[str, Any]:
        client: Any = lab.bus_of(name).handler.__self__  # type: ignore[union-attr]
        put = client._bus.put

        def speak(key: str, raw: bytes) -> None:
            act = read(raw)
            if isinstance(act, Act) and act.tick == 30:
                said = Frames(FrameKind.RELAY, 1, np.array([uav], np.int32), model)
                put(key, tick.write_act(Act(act.run, act.tick, act.commands, outbox=(said,), models=act.models)))
            put(key, raw)

        client._bus.put = speak
        summary: dict[str, Any] = lab.fly()["dropped_messages"]
        return summary

    assert extra(Lab(swarm(), uavs_per_node=1), "agent-5", 5) == {"wrong-shape": 1}
    assert extra(Lab(swarm(), uavs_per_node=1), "agent-4", 4) == {"wrong-round": 1, "duplicate": 1}
    assert extra(Lab(swarm(clusters=1), uavs_per_node=1), "agent-0", 0) == {"wrong-kind": 1}


@pytest.mark.parametrize(
    ("when", "refused"),
    [(21, (~0,)), (21, (~5, ~5)), (21, (~12,)), (20, (~5,)), (21, (5, 5)), (21, (12,)), (20, (5, 5)), (30, (4,))],
    ids=str,
)
def test_a_node_refuses_uploads_of_its_own_cluster_once_and_when_it_averages(when: int, refused: tuple[int]) -> None:
    lab = Lab(swarm(), uavs_per_node=1)
    client: Any = lab.bus_of("agent-4").handler.__self__  # type: ignore[union-attr]
    put = client._bus.put

    def speak(key: str, raw: bytes) -> None:
        act = read(raw)
        if isinstance(act, Act) and act.tick == when:
            put(key, tick.write_act(Act(act.run, act.tick, act.commands, refused=np.array(refused))))
        put(key, raw)

    client._bus.put = speak
    summary = lab.fly()
    assert (summary["dropped_messages"], summary["uploads_refused"]) == ({"wrong-shape": 1}, 0)
    assert summary["states_refused"] == 0


@pytest.mark.parametrize(
    ("when", "refused", "counted"), [(PERIOD, (5,), (0, 1)), (PERIOD + 1, (5,), (0, 1)), (PERIOD + 1, (~5, 5), (1, 1))]
)
def test_states_and_uploads_that_a_head_refuses_are_counted_apart_in_any_tick(
    when: int, refused: tuple[int, ...], counted: tuple[int, int]
) -> None:
    lab = Lab(swarm(), uavs_per_node=1)
    client: Any = lab.bus_of("agent-4").handler.__self__  # type: ignore[union-attr]
    put = client._bus.put

    def speak(key: str, raw: bytes) -> None:
        act = read(raw)
        if isinstance(act, Act) and act.tick == when:
            raw = tick.write_act(msgspec.structs.replace(act, refused=np.array(refused)))
        put(key, raw)

    client._bus.put = speak
    summary = lab.fly()
    assert (summary["dropped_messages"], summary["uploads_refused"], summary["states_refused"]) == ({}, *counted)


@pytest.mark.parametrize("clusters", [1, 3])
def test_who_takes_no_part_in_a_round_is_not_heard_in_it(clusters: int) -> None:
    of = swarm("federation.fraction=0.5", clusters=clusters)
    expected = Lab(of, uavs_per_node=1).fly()
    lab = Lab(of, uavs_per_node=1)
    takes_part = [uav for uav in range(12) if 11 in Schedule(of).participants(1 + uav)]
    idle = [number for number in range(1, 6) if 11 not in Schedule(of).participants(number)]
    assert idle
    assert takes_part
    client: Any = lab.bus_of("agent-11").handler.__self__  # type: ignore[union-attr]
    put = client._bus.put

    def speak(key: str, raw: bytes) -> None:
        act = read(raw)
        if isinstance(act, Act) and act.tick % PERIOD == 0 and act.tick // PERIOD in idle:
            model = np.full((1, FLOATS), 5.0, np.float32)
            said = Frames(FrameKind.UPLOAD, act.tick // PERIOD, np.array([11], np.int32), model)
            raw = tick.write_act(Act(act.run, act.tick, act.commands, outbox=(said,), models=act.models))
        put(key, raw)

    client._bus.put = speak
    summary = lab.fly()
    assert summary["dropped_messages"] == {"wrong-round": len(idle)}
    assert summary["trajectory_sha256"] == expected["trajectory_sha256"]


def test_a_head_that_lies_speaks_for_its_cluster_and_no_more() -> None:
    """The documented limit: what it hands on weighs as much as its cluster has UAVs."""
    lab = Lab(swarm("federation.fraction=1.0", *CLEAR), uavs_per_node=1)
    hostile_relay = np.full(FLOATS, 7.0)
    heard: list[np.ndarray] = []
    client: Any = lab.bus_of("agent-4").handler.__self__  # type: ignore[union-attr]
    put, send = client._bus.put, lab.world.air.send

    def speak(key: str, raw: bytes) -> None:
        act = read(raw)
        if isinstance(act, Act) and act.tick == PERIOD + 1:
            payload = np.append(hostile_relay, 4.0)[None]
            said = Frames(FrameKind.RELAY, 1, np.array([4], np.int32), payload)
            raw = tick.write_act(Act(act.run, act.tick, act.commands, outbox=(said,), models=act.models))
        put(key, raw)

    def listen(tick: int, frames: list[Frames], *rest: Any) -> Any:
        heard.extend(batch.payload[0] for batch in frames if batch.kind == FrameKind.GLOBAL and batch.round == 1)
        return send(tick, frames, *rest)

    client._bus.put, lab.world.air.send = speak, listen  # type: ignore[method-assign, assignment]
    lab.fly()
    honest = globals_of(swarm("federation.fraction=1.0", *CLEAR))[0]
    moved = heard[0] - honest
    own = (3 * heard[0] - hostile_relay) / 2  # the mean of the other eight
    assert np.abs(moved).max() > 1
    assert np.abs(own - honest).max() < 1
