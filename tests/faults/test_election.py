"""One leader at a time, the same for everyone who asks, and no round averaged twice."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meanflock.federation.post import Mailbox
from meanflock.swarm.wire.messages import FrameKind, Frames
from meanflock.worldsim.members import elect
from tests.faults.conftest import Lab, scenario

NAMES = st.sets(st.sampled_from(["leader", "leader.2", "leader.3", "leader.10", "b"]))


@settings(max_examples=100, deadline=None, database=None)
@given(NAMES, st.randoms(use_true_random=False))
def test_the_election_depends_on_who_lives_and_on_nothing_else(living: set[str], shuffler: object) -> None:
    order = sorted(living)
    shuffler.shuffle(order)  # type: ignore[attr-defined]
    assert elect(order) == (min(living) if living else None)
    for incumbent in living:
        assert elect(order, incumbent) == incumbent
    assert elect(order, "gone") == elect(order)


def lead(at: dict[int, str], leaders: int = 2, **options: object) -> tuple[Lab, dict[str, object]]:
    lab = Lab(scenario(), leaders=leaders, **options)
    deeds: dict[int, Callable[[], object]] = {tick: (lambda name=name: lab.kill(name)) for tick, name in at.items()}
    return lab, lab.fly(deeds)


@pytest.fixture(scope="module")
def undisturbed() -> dict[str, object]:
    return lead({})[1]


@pytest.mark.parametrize("tick", [15, 20, 21, 22, 40, 41])
def test_a_standby_takes_over_within_one_round_and_the_flight_is_the_same(
    tick: int, undisturbed: dict[str, object]
) -> None:
    lab, summary = lead({tick: "leader"})
    assert summary["trajectory_sha256"] == undisturbed["trajectory_sha256"]
    assert summary["rounds"] == undisturbed["rounds"] == 5
    assert summary["nodes_lost"] == 1
    rounds = [event.tick for event in lab.record.events if event.kind == "round"]
    assert rounds == [21, 41, 61, 81, 101]
    (takeover,) = lab.record.kinds("leader")
    assert tick <= takeover[0] <= tick + 20


def test_a_third_leader_takes_over_from_the_second_by_name(undisturbed: dict[str, object]) -> None:
    lab, summary = lead({30: "leader", 50: "leader.2"}, leaders=3)
    assert summary["trajectory_sha256"] == undisturbed["trajectory_sha256"]
    texts = [event.text for event in lab.record.events if event.kind == "leader"]
    assert texts == ["leader.2 takes over from leader", "leader.3 takes over from leader.2"]


def test_a_leader_that_dies_while_it_is_asked_is_replaced_in_the_same_tick(undisturbed: dict[str, object]) -> None:
    for dies_after_answering in (False, True):
        lab = Lab(scenario(), leaders=2)
        bus = lab.bus_of("leader")
        handler = bus.handler
        assert handler is not None

        def once(delivery: object, bus=bus, handler=handler, last=dies_after_answering, lab=lab) -> None:
            if lab.world.flight.tick == 41:
                if last:
                    handler(delivery)
                bus.close()
            else:
                handler(delivery)

        bus.handler = once
        summary = lab.fly()
        assert summary["trajectory_sha256"] == undisturbed["trajectory_sha256"]
        assert [e.tick for e in lab.record.events if e.kind == "round"] == [21, 41, 61, 81, 101]


def test_without_a_standby_a_round_is_void_and_a_restarted_leader_averages_the_next() -> None:
    lab = Lab(scenario())
    summary = lab.fly({35: lambda: lab.kill("leader"), 50: lab.leader})
    assert lab.record.kinds("round", "void") == [
        (21, "round"),
        (41, "void"),
        (61, "round"),
        (81, "round"),
        (101, "round"),
    ]
    assert summary["rounds"] == 4


def test_a_restarted_leader_stands_by_while_another_leads(undisturbed: dict[str, object]) -> None:
    lab = Lab(scenario(), leaders=2)
    summary = lab.fly({30: lambda: lab.kill("leader"), 50: lab.leader, 70: lambda: lab.kill("leader.2")})
    assert summary["trajectory_sha256"] == undisturbed["trajectory_sha256"]
    texts = [event.text for event in lab.record.events if event.kind == "leader"]
    assert texts == ["leader.2 takes over from leader", "leader.3 takes over from leader.2"]


def test_a_leader_that_averages_a_round_again_is_not_heard() -> None:
    slow = scenario("uavs=3", "radio.coherence_time_s=0.1", "radio.target_snr_db=76")  # rounds are open for some ticks
    honest = Lab(slow).fly()
    lab = Lab(slow)
    client = lab.bus_of("leader").handler.__self__  # type: ignore[union-attr]
    act, said = client._node.act, []

    def again(sense):  # type: ignore[no-untyped-def]
        answer = act(sense)
        said.extend(answer.outbox)
        if sense.tick == 61:
            assert not answer.outbox
            old = said[-1]
            answer = type(answer)(answer.run, answer.tick, answer.commands, outbox=(old,))
        return answer

    client._node.act = again
    summary = lab.fly()
    assert summary["dropped_messages"] == {"duplicate": 1}
    assert summary["trajectory_sha256"] == honest["trajectory_sha256"]


def test_uploads_spread_over_several_ticks_all_reach_whoever_leads_when_the_round_closes() -> None:
    slow = ("radio.coherence_time_s=0.1", "radio.target_snr_db=76")
    honest = Lab(scenario(*slow), leaders=2)
    expected = honest.fly()
    for tick in (22, 23, 25, 28):
        lab = Lab(scenario(*slow), leaders=2)
        summary = lab.fly({tick: lambda lab=lab: lab.kill("leader")})
        assert summary["trajectory_sha256"] == expected["trajectory_sha256"], tick


def test_a_leader_reads_its_mail_once_and_a_new_leader_reads_all() -> None:
    def batch(number: int, uav: int) -> Frames:
        links = np.array([[0, 0]], dtype=np.int32)
        return Frames(FrameKind.UPLOAD, number, np.array([uav], np.int32), np.zeros((1, 2), np.float32), links)

    box = Mailbox()
    box.put(batch(1, 1))
    assert [f.source[0] for f in box.read("a")] == [1]
    box.put(batch(1, 2))
    box.put(batch(2, 3))
    assert [f.source[0] for f in box.read("a")] == [2, 3]
    assert [f.source[0] for f in box.read("b")] == [1, 2, 3]
    box.close(1)
    assert box.read("b") == ()
    assert [f.source[0] for f in box.read("a")] == [3]
    box.close(2)
    assert list(itertools.chain(box.read("a"), box.read("c"))) == []
