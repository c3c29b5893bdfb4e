"""Questions cut from strings are those the codec writes, whoever hears the model."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm import codec
from swarm.messages import FrameKind, Frames, Sense
from tests.worldsim.test_barrier import FINGERPRINT, TICK
from worldsim import inbox
from worldsim.members import Member
from worldsim.questions import Questions

UAVS = 9
STATES = np.random.default_rng(0).normal(size=(UAVS, 4))
NODES = [Member(f"agent-{uavs[0]}", "agent", np.array(uavs)) for uavs in ([0], [1], [2, 3, 4], [5, 7], [6, 8])]
AWAKE = np.ones(UAVS, dtype=bool)


def model(targets: list[int]) -> Frames:
    links = np.array([[0, target] for target in targets], np.int32).reshape(-1, 2)
    payload = np.arange(246, dtype=np.float32)[None]
    return Frames(FrameKind.GLOBAL, 3, np.array([4], np.int32), payload, links)


@given(st.sets(st.integers(0, UAVS - 1)), st.booleans())
def test_a_question_that_may_bring_the_model_is_what_the_codec_writes(targets: set[int], report: bool) -> None:
    brought = model(sorted(targets))
    questions = Questions(FINGERPRINT, TICK, report, STATES, brought)
    for member in NODES:
        links = np.array([[0, uav] for uav in member.uavs if uav in targets], np.int32).reshape(-1, 2)
        heard = (Frames(brought.kind, brought.round, brought.source, brought.payload, links),) if len(links) else ()
        assert questions.of(member) == codec.encode(Sense(FINGERPRINT, TICK, STATES[member.uavs], report, heard))


@pytest.mark.parametrize("report", [False, True])
def test_a_question_that_brings_nothing_is_what_the_codec_writes(report: bool) -> None:
    questions = Questions(FINGERPRINT, TICK, report, STATES)
    for member in NODES:
        assert questions.of(member) == codec.encode(Sense(FINGERPRINT, TICK, STATES[member.uavs], report))


@pytest.mark.parametrize("rows", [1, 3])
@pytest.mark.parametrize("report", [False, True])
@pytest.mark.parametrize("brought", [None, model(list(range(UAVS)))])
def test_questions_to_nodes_that_are_alike_are_those_to_each(rows: int, report: bool, brought: Frames | None) -> None:
    nodes = [Member(f"agent-{first}", "agent", np.arange(first, first + rows)) for first in range(0, UAVS, rows)]
    questions, firsts = Questions(FINGERPRINT, TICK, report, STATES, brought), [int(node.uavs[0]) for node in nodes]
    assert questions.of_each(rows, firsts) == [questions.of(node) for node in nodes]
    some = Questions(FINGERPRINT, TICK, report, STATES, model([0, 4]))
    assert some.of_each(rows, firsts) == ([some.of(node) for node in nodes] if rows == 1 else None)


def test_agents_hear_what_is_not_kept_for_who_averages_and_only_awake() -> None:
    upload = Frames(FrameKind.UPLOAD, 3, np.array([1], np.int32), np.zeros((1, 4), np.float32), model([0]).links)
    assert inbox.of_agents([upload], AWAKE) == []
    some = AWAKE.copy()
    some[[0, 2]] = False
    assert inbox.of_agents([model([0, 2])], some) == []
    (heard,) = inbox.of_agents([upload, model([0, 1, 2, 5])], some)
    assert heard.links is not None
    assert heard.links[:, 1].tolist() == [1, 5]
    (same,) = inbox.of_agents([heard], AWAKE)
    assert same is heard


def test_only_one_global_model_to_uavs_in_order_is_nothing_but_a_model() -> None:
    good = model([0, 1, 5])
    assert inbox.only_a_model([good]) is good
    states = Frames(FrameKind.STATE, 0, np.array([4], np.int32), np.zeros((1, 4), np.float32), good.links)
    two = Frames(FrameKind.GLOBAL, 3, np.array([4, 5], np.int32), np.zeros((2, 246), np.float32), good.links)
    for other in ([], [good, good], [states], [two], [model([1, 0])], [model([1, 1])]):
        assert inbox.only_a_model(other) is None


def test_a_node_hears_its_part() -> None:
    heard = Frames(
        FrameKind.STATE,
        0,
        np.array([2, 5, 8], np.int32),
        np.arange(12, dtype=np.float32).reshape(3, 4),
        np.array([[0, 1], [1, 7], [2, 5], [2, 1]], np.int32),
    )
    (own,) = inbox.of_agent(NODES[3], [heard], UAVS)
    assert own.source.tolist() == [5, 8]
    assert own.payload.tolist() == heard.payload[1:].tolist()
    assert own.links is not None
    assert own.links.tolist() == [[0, 7], [1, 5]]
    assert inbox.of_agent(NODES[0], [heard], UAVS) == ()
    assert inbox.of_agent(Member("agent-0", "agent", np.arange(UAVS)), [heard], UAVS) == (heard,)
