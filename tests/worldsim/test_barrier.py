"""The barrier tells plain answers by their bytes, and takes each for what the codec would."""

import queue
import threading

import numpy as np
import pytest

from swarm import codec, keys
from swarm.bus import Bus, MemoryNetwork
from swarm.errors import MessageRejected
from swarm.messages import Act, FrameKind, Frames, Sense
from swarm.scenario import load
from tests.polling import DEADLINE_S
from worldsim.barrier import Barrier
from worldsim.members import Member

RUN = "fence"
FINGERPRINT = keys.fingerprint(RUN)
TICK = 300
STATES = np.arange(8.0).reshape(2, 4)
OUTCOME = np.arange(10.0).reshape(2, 5)
MODELS = np.ones((2, 246))
KEY = keys.act(RUN, "agent-0")
FRAMES = Frames(FrameKind.STATE, 0, np.zeros(1, np.int32), np.zeros((1, 4), np.float32), np.zeros((1, 2), np.int32))


class Stand:
    """A barrier with one agent of two UAVs in front of it."""

    def __init__(self, reporting: bool = False) -> None:
        network = MemoryNetwork()
        self.agent: Bus = network.endpoint()
        self.agent.subscribe(keys.sense(RUN, "agent-0"))
        self.barrier = Barrier(network.endpoint(), RUN, load(None, uavs=3))
        self.member = Member("agent-0", "agent", np.arange(2))
        self.barrier.open(TICK, reporting)

    def asked(self, *heard: Frames, whole: bool = False) -> bytes:
        """What the agent hears when it is asked."""
        self.barrier.ask(self.member, STATES, heard, whole)
        delivery = self.agent.receive(0.0)
        assert delivery is not None
        return delivery.payload


@pytest.mark.parametrize("reporting", [False, True])
@pytest.mark.parametrize("heard", [(), (FRAMES,)])
@pytest.mark.parametrize("whole", [False, True])
def test_a_question_is_what_the_codec_writes(reporting: bool, heard: tuple[Frames, ...], whole: bool) -> None:
    raw = Stand(reporting).asked(*heard, whole=whole)
    assert raw == codec.encode(Sense(FINGERPRINT, TICK, STATES, reporting, heard, whole))


@pytest.mark.parametrize("reporting", [False, True])
@pytest.mark.parametrize("uavs", [[0], [1, 2], [0, 2]])  # the last are not side by side
def test_plain_questions_are_what_the_codec_writes(reporting: bool, uavs: list[int]) -> None:
    stand, states = Stand(reporting), np.arange(12.0).reshape(3, 4)
    stand.barrier.ask_all([Member("agent-0", "agent", np.array(uavs))], states)
    delivery = stand.agent.receive(0.0)
    assert delivery is not None
    assert delivery.payload == codec.encode(Sense(FINGERPRINT, TICK, states[uavs], reporting))
    assert stand.barrier.missing == ["agent-0"]


def test_a_leader_has_no_models_to_report() -> None:
    stand = Stand(reporting=True)
    stand.member = Member("agent-0", "leader", np.zeros(0, dtype=np.intp))
    stand.barrier.ask(stand.member, np.zeros((0, 4)))
    delivery = stand.agent.receive(0.0)
    assert delivery is not None
    assert delivery.payload == codec.encode(Sense(FINGERPRINT, TICK, np.zeros((0, 4)), False))
    assert not stand.barrier.overhear(KEY, codec.encode(Act(FINGERPRINT, TICK, np.zeros((0, 5)))), 0)
    assert not stand.barrier.complete


def test_a_plain_answer_counts_once() -> None:
    stand = Stand()
    stand.asked()
    raw = codec.encode(Act(FINGERPRINT, TICK, OUTCOME))
    assert stand.barrier.missing == ["agent-0"]
    assert stand.barrier.overhear(KEY, raw, 0)
    assert stand.barrier.complete
    assert stand.barrier.outcomes == {"agent-0": OUTCOME.tobytes()}
    assert not stand.barrier.acts
    assert not stand.barrier.overhear(KEY, raw, 0)
    with pytest.raises(MessageRejected) as refused:
        stand.barrier.answer("agent-0", Act(FINGERPRINT, TICK, OUTCOME))
    assert refused.value.reason == "duplicate"


def test_an_answer_with_a_report_is_kept_with_it() -> None:
    stand = Stand(reporting=True)
    stand.asked()
    assert stand.barrier.overhear(KEY, codec.encode(Act(FINGERPRINT, TICK, OUTCOME, report=MODELS)), 0)
    assert stand.barrier.reports == {"agent-0": MODELS.tobytes()}
    assert not stand.barrier.acts
    assert stand.barrier.outcomes["agent-0"] == OUTCOME.tobytes()
    assert stand.barrier.forget("agent-0")
    assert not stand.barrier.reports


@pytest.mark.parametrize(
    "other",
    [
        codec.encode(Act(FINGERPRINT, TICK - 1, OUTCOME)),
        codec.encode(Act(FINGERPRINT + 1, TICK, OUTCOME)),
        codec.encode(Act(FINGERPRINT, TICK, OUTCOME[:1])),
        codec.encode(Act(FINGERPRINT, TICK, OUTCOME, diverged=(1,))),
        codec.encode(Act(FINGERPRINT, TICK, OUTCOME, report=MODELS)),
        codec.encode(Act(FINGERPRINT, TICK, np.full((2, 5), np.inf))),
        codec.encode(Act(FINGERPRINT, TICK, np.full((2, 5), np.nan))),
        b"",
    ],
)
def test_whatever_is_not_plain_is_left_to_the_codec(other: bytes) -> None:
    stand = Stand()
    stand.asked()
    assert not stand.barrier.overhear(KEY, other, 0)
    assert stand.barrier.missing == ["agent-0"]


def test_nobody_is_heard_who_was_not_asked_or_is_gone_or_comes_late() -> None:
    raw = codec.encode(Act(FINGERPRINT, TICK, OUTCOME))
    stand = Stand()
    assert not stand.barrier.overhear(KEY, raw, 0)
    stand.asked()
    assert not stand.barrier.overhear(keys.act(RUN, "agent-1"), raw, 0)
    assert stand.barrier.forget("agent-0")
    assert not stand.barrier.overhear(KEY, raw, 0)
    stand.asked()
    stand.barrier.close()
    assert not stand.barrier.overhear(KEY, raw, 0)
    assert not stand.barrier.outcomes


def test_who_is_asked_twice_may_answer_twice_and_not_more_often() -> None:
    stand = Stand()
    stand.asked()
    assert not stand.barrier.is_repeat("agent-0")
    stand.barrier.ask_again()
    stand.barrier.ask_again()
    assert stand.barrier.overhear(KEY, codec.encode(Act(FINGERPRINT, TICK, OUTCOME)), 0)
    stand.barrier.ask_again()  # it has answered
    stand.barrier.open(TICK + 1, False)  # its other answers may come as late as this
    assert [stand.barrier.is_repeat("agent-0") for _ in range(3)] == [True, True, False]
    assert not stand.barrier.is_repeat("agent-1")


def test_the_last_answer_is_left_to_who_waits() -> None:
    stand = Stand()
    stand.asked()
    raw = codec.encode(Act(FINGERPRINT, TICK, OUTCOME))
    assert not stand.barrier.overhear(KEY, raw)
    stand.barrier.ask_all([Member("agent-2", "agent", np.array([0, 1]))], STATES)
    assert not stand.barrier.overhear(KEY, codec.encode(Act(FINGERPRINT, TICK - 1, OUTCOME)))
    assert stand.barrier.overhear(KEY, raw)
    assert stand.barrier.missing == ["agent-2"]
    assert not stand.barrier.overhear(KEY, raw)
    assert not stand.barrier.overhear(keys.act(RUN, "agent-2"), raw)
    assert stand.barrier.overhear(keys.act(RUN, "agent-2"), raw, 0)
    assert stand.barrier.complete
    assert list(stand.barrier.outcomes) == ["agent-0", "agent-2"]


def test_whoever_waits_wakes_however_answers_come_in_two_threads() -> None:
    barrier = Barrier(MemoryNetwork().endpoint(), RUN, load(None, uavs=12))
    crowd = [Member(f"agent-{uav}", "agent", np.array([uav])) for uav in range(12)]
    waiting: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
    asked: queue.SimpleQueue[int | None] = queue.SimpleQueue()
    shuffle = np.random.default_rng(1).permutation

    def bring() -> None:
        while (tick := asked.get()) is not None:
            for uav in shuffle(12):
                key = keys.act(RUN, f"agent-{uav}")
                raw = codec.encode(Act(FINGERPRINT, tick, np.full((1, 5), float(uav + tick))))
                if uav % 3 == 0 or not barrier.overhear(key, raw):  # every third is none of those that are overheard
                    waiting.put((key, raw))

    thread = threading.Thread(target=bring)
    thread.start()
    try:
        for tick in range(300):
            barrier.open(tick, reporting=False)
            barrier.ask_all(crowd, np.zeros((12, 4)))
            asked.put(tick)
            while not barrier.complete:
                assert barrier.overhear(*waiting.get(timeout=DEADLINE_S), 0)
            barrier.close()
            expected = {member.name: np.full(5, uav + tick, float).tobytes() for uav, member in enumerate(crowd)}
            assert barrier.outcomes == expected
    finally:
        asked.put(None)
        thread.join()
