"""Uploads no honest process can send: bytes of one's own making, under one's own name, in the tick of a round."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from meanflock.swarm.wire import tick
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from tests.faults.conftest import Lab, scenario
from tests.swarm.examples import read

RULES = ("fedavg", "median", "trimmed-mean", "krum")
ROUNDS = 5  # of the flight, opened in ticks 20, 40 …


def poisoned(act: Act, value: float) -> bytes:
    """The act with one weight of its upload replaced, as bytes the encoder of an honest node would not have made."""
    raw = tick.write_act(act)
    (upload,) = act.outbox
    weights = upload.payload.copy()
    at = raw.index(weights.tobytes())
    weights[0, 0] = value
    return raw[:at] + weights.tobytes() + raw[at + weights.nbytes :]


def hostile(lab: Lab, name: str, say: Callable[[Act, Callable[[bytes], None]], None]) -> None:
    """From now on what a node says in a round's tick is `say`'s to decide; it is given the honest act and the bus."""
    client: Any = lab.bus_of(name).handler.__self__  # type: ignore[union-attr]
    put = client._bus.put

    def speak(key: str, raw: bytes) -> None:
        act = read(raw)
        if isinstance(act, Act) and any(frames.kind == FrameKind.UPLOAD for frames in act.outbox):
            say(act, lambda raw: put(key, raw))
        else:
            put(key, raw)

    client._bus.put = speak


def swarm(rule: str, *extra: str) -> Lab:
    return Lab(scenario("federation.fraction=1.0", f'federation.aggregation="{rule}"', *extra), uavs_per_node=1)


@pytest.mark.parametrize(("rule", "value"), list(zip(RULES, (np.nan, np.inf, -np.inf, np.nan), strict=True)))
def test_weights_that_are_no_numbers_are_dropped_and_counted_and_the_flight_is_as_if_they_had_not_come(
    rule: str, value: float
) -> None:
    expected = swarm(rule).fly()
    lab = swarm(rule)

    def say(act: Act, put: Callable[[bytes], None]) -> None:
        put(poisoned(act, value))
        put(tick.write_act(act))

    hostile(lab, "agent-3", say)
    summary = lab.fly()
    assert summary["dropped_messages"] == {"non-finite": ROUNDS}
    assert summary["trajectory_sha256"] == expected["trajectory_sha256"]
    assert summary["rounds"] == expected["rounds"] == ROUNDS


def test_who_says_nothing_else_is_lost_and_the_others_average_without_it() -> None:
    lab = swarm("fedavg")
    times = iter(range(10**9))
    lab.world._waiting._clock = lambda: float(next(times))  # the barrier's patience ends at once
    hostile(lab, "agent-3", lambda act, put: put(poisoned(act, np.nan)))
    summary = lab.fly()
    assert summary["dropped_messages"]["non-finite"] >= 1
    assert (summary["lost"], summary["nodes_lost"], summary["rounds"]) == (1, 1, ROUNDS)


def test_one_weight_of_a_genuine_float_beyond_all_bounds_is_let_in_by_the_codec_and_refused_by_the_leader() -> None:
    lab = swarm("fedavg")
    hostile(lab, "agent-3", lambda act, put: put(poisoned(act, 1e30)))
    summary = lab.fly()
    assert summary["dropped_messages"] == {}
    assert 0 < summary["uploads_refused"] <= ROUNDS  # an outage may have kept one from the leader
    assert summary["rounds"] == ROUNDS


def test_nobody_can_take_the_uploads_of_all_to_another_round() -> None:
    """Frames of a kind go on the air together, those of UAV 0 first: its word for the round was everybody's."""
    alone = swarm("fedavg", "federation.leader=5")
    hostile(
        alone, "agent-0", lambda act, put: put(tick.write_act(Act(act.run, act.tick, act.commands, models=act.models)))
    )
    silent = alone.fly()
    lab = swarm("fedavg", "federation.leader=5")

    def elsewhere(act: Act, put: Callable[[bytes], None]) -> None:
        (upload,) = act.outbox
        stray = Frames(upload.kind, 2**31, upload.source, upload.payload)
        put(tick.write_act(Act(act.run, act.tick, act.commands, outbox=(stray,), models=act.models)))

    hostile(lab, "agent-0", elsewhere)
    summary = lab.fly()
    assert summary["dropped_messages"] == {"wrong-round": ROUNDS}
    assert summary["rounds"] == ROUNDS
    assert summary["trajectory_sha256"] == silent["trajectory_sha256"]
    assert not any(box._frames for box in lab.world.post._boxes.values())


def test_an_upload_between_rounds_is_not_kept() -> None:
    lab = swarm("fedavg")
    client: Any = lab.bus_of("agent-2").handler.__self__  # type: ignore[union-attr]
    put = client._bus.put
    model = np.zeros((1, 108), np.float32)

    def always(key: str, raw: bytes) -> None:
        act = read(raw)
        if isinstance(act, Act) and not act.outbox:
            extra = Frames(FrameKind.UPLOAD, act.tick + 1, np.array([2], np.int32), model)
            raw = tick.write_act(Act(act.run, act.tick, act.commands, outbox=(extra,), models=act.models))
        put(key, raw)

    client._bus.put = always
    summary = lab.fly()
    assert summary["dropped_messages"]["wrong-round"] == 120 - ROUNDS
    assert not any(box._frames for box in lab.world.post._boxes.values())
