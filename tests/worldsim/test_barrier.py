"""The barrier: every node of a tick is asked and replies once, and the waiting thread wakes at the last reply."""

import queue
import threading

import numpy as np
import pytest

from meanflock.federation.post import Post
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus, MemoryNetwork
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire import control, tick
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Ready, Sense
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.limits import Limits
from meanflock.worldsim.members import Member
from meanflock.worldsim.replies import Replies
from tests.polling import DEADLINE_S

RUN = "fence"
FINGERPRINT = keys.fingerprint(RUN)
TICK = 300
STATES = np.arange(8.0).reshape(2, 4)
COMMANDS = np.arange(10.0).reshape(2, 5)
MODELS = np.ones((2, 246))
KEY = keys.act(RUN, "agent-0")
FRAMES = Frames(FrameKind.STATE, 0, np.zeros(1, np.int32), np.zeros((1, 4), np.float32), np.zeros((1, 2), np.int32))


def barrier_of(bus: Bus, flown: Scenario) -> Barrier:
    return Barrier(bus, RUN, Replies(flown, FINGERPRINT, Post(flown), Limits(flown).act))


class Stand:
    """A barrier with an agent of two UAVs in front of it, and perhaps another that is silent."""

    def __init__(self, reporting: bool = False) -> None:
        network = MemoryNetwork()
        self.agent: Bus = network.endpoint()
        self.agent.subscribe(keys.sense(RUN, "agent-0"))
        self.barrier = barrier_of(network.endpoint(), load(None, uavs=3))
        self.member = Member("agent-0", "agent", np.arange(2))
        self.barrier.open(TICK, reporting)

    def asked(self, *heard: Frames, whole: bool = False) -> bytes:
        """What the agent hears when it is asked."""
        self.barrier.ask(self.member, STATES, heard, whole)
        delivery = self.agent.receive(0.0)
        assert delivery is not None
        return delivery.payload

    def asked_with_another(self) -> None:
        """The agent is asked, and one that says nothing."""
        self.asked()
        self.barrier.ask(Member("agent-2", "agent", np.array([2])), STATES[:1])


def reply(number: int = TICK, rows: int = 2, models: np.ndarray | None = None, run: int = FINGERPRINT) -> bytes:
    return tick.write_act(Act(run, number, COMMANDS[:rows], models=models))


@pytest.mark.parametrize("reporting", [False, True])
@pytest.mark.parametrize("heard", [(), (FRAMES,)])
@pytest.mark.parametrize("whole", [False, True])
def test_a_request_is_a_sense_with_the_states_and_frames_of_the_node(
    reporting: bool, heard: tuple[Frames, ...], whole: bool
) -> None:
    raw = Stand(reporting).asked(*heard, whole=whole)
    assert raw == tick.write_sense(Sense(FINGERPRINT, TICK, STATES, reporting, whole, heard))


def test_a_leader_reports_no_models_and_gets_the_state_of_the_aggregation() -> None:
    stand = Stand(reporting=True)
    leader = Member("agent-0", "leader", np.zeros(0, dtype=np.intp))
    stand.barrier.ask(leader, np.zeros((0, 4)), memory=b"\x80")
    delivery = stand.agent.receive(0.0)
    assert delivery is not None
    assert delivery.payload == tick.write_sense(Sense(FINGERPRINT, TICK, np.zeros((0, 4)), False, memory=b"\x80"))
    assert stand.barrier.silent
    stand.barrier.take(leader, tick.write_act(Act(FINGERPRINT, TICK, np.zeros((0, 2)))))
    assert not stand.barrier.silent


@pytest.mark.parametrize("models", [None, MODELS])
def test_a_reply_counts_once(models: np.ndarray | None) -> None:
    stand = Stand(reporting=models is not None)
    stand.asked_with_another()
    raw = reply(models=models)
    assert stand.barrier.missing == ["agent-0", "agent-2"]
    assert stand.barrier.offer(KEY, raw)
    assert stand.barrier.missing == ["agent-2"]
    assert tick.write_act(stand.barrier.acts["agent-0"]) == raw
    assert stand.barrier.replied.tolist() == [True, True, False]
    assert (stand.barrier.commands[:2] == COMMANDS).all()
    assert not stand.barrier.offer(KEY, raw)
    with pytest.raises(MessageRejected) as refused:
        stand.barrier.take(stand.member, raw)
    assert refused.value.reason == "duplicate"
    other = tick.write_act(Act(FINGERPRINT, TICK, -COMMANDS))
    with pytest.raises(MessageRejected):
        stand.barrier.take(stand.member, other)
    assert (stand.barrier.commands[:2] == COMMANDS).all()
    assert stand.barrier.forget("agent-0")
    assert not stand.barrier.acts
    assert not stand.barrier.replied.any()


def test_commands_are_in_the_rows_of_uavs_that_do_not_follow_each_other() -> None:
    barrier = barrier_of(MemoryNetwork().endpoint(), load(None, uavs=5))
    member = Member("agent-1", "agent", np.array([1, 4]))
    barrier.open(TICK, reporting=False)
    barrier.ask(member, STATES)
    barrier.take(member, reply())
    assert (barrier.commands[[1, 4]] == COMMANDS).all()
    assert barrier.replied.tolist() == [False, True, False, False, True]


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (reply(TICK - 1), "stale"),
        (reply(rows=1), "wrong-shape"),
        (tick.write_act(Act(FINGERPRINT, TICK, np.full((2, 5), np.nan))), "non-finite"),
        (control.encode(Ready(FINGERPRINT)), "malformed"),
        (b"", "malformed"),
    ],
)
def test_a_wrong_reply_is_left_to_the_world_and_rejected_there(other: bytes, reason: str) -> None:
    stand = Stand()
    stand.asked_with_another()
    assert not stand.barrier.offer(KEY, other)
    with pytest.raises(MessageRejected) as rejected:
        stand.barrier.take(stand.member, other)
    assert rejected.value.reason == reason
    assert stand.barrier.missing == ["agent-0", "agent-2"]
    assert not stand.barrier.acts
    assert not stand.barrier.replied.any()


def test_a_reply_counts_only_from_a_node_that_was_asked_and_is_there() -> None:
    raw, stand = reply(), Stand()
    assert not stand.barrier.offer(KEY, raw)
    stand.asked_with_another()
    assert not stand.barrier.offer(keys.act(RUN, "agent-1"), raw)
    assert stand.barrier.forget("agent-0")
    assert not stand.barrier.forget("agent-0")
    assert not stand.barrier.offer(KEY, raw)
    stand.asked()
    stand.barrier.close()
    assert not stand.barrier.offer(KEY, raw)
    assert not stand.barrier.acts


def test_a_node_that_is_asked_twice_may_answer_twice() -> None:
    stand = Stand()
    first = stand.asked()
    assert not stand.barrier.is_repeat("agent-0")
    for _ in range(2):
        stand.barrier.ask_again()
        delivery = stand.agent.receive(0.0)
        assert delivery is not None
        assert delivery.payload == first
    stand.barrier.take(stand.member, reply())
    stand.barrier.ask_again()  # it has answered
    stand.barrier.open(TICK + 1, False)  # its other answers may come as late as this
    assert [stand.barrier.is_repeat("agent-0") for _ in range(3)] == [True, True, False]
    assert not stand.barrier.is_repeat("agent-1")


def test_the_last_reply_is_left_to_the_waiting_thread() -> None:
    stand = Stand()
    stand.asked()
    raw = reply()
    assert not stand.barrier.offer(KEY, raw)
    other = Member("agent-2", "agent", np.array([2]))
    stand.barrier.ask(other, STATES[:1])
    assert stand.barrier.offer(KEY, raw)
    assert stand.barrier.missing == ["agent-2"]
    assert not stand.barrier.offer(keys.act(RUN, "agent-2"), reply(rows=1))
    stand.barrier.take(other, reply(rows=1))
    assert not stand.barrier.silent
    assert list(stand.barrier.acts) == ["agent-0", "agent-2"]


def test_frames_are_in_the_order_in_which_nodes_were_asked() -> None:
    stand = Stand()
    crowd = [Member(f"agent-{uav}", "agent", np.array([uav])) for uav in range(3)]
    for member in crowd:
        stand.barrier.ask(member, STATES[:1])
    for uav in (2, 0, 1):
        said = Frames(FrameKind.STATE, 0, np.array([uav], np.int32), np.zeros((1, 4), np.float32))
        stand.barrier.take(crowd[uav], tick.write_act(Act(FINGERPRINT, TICK, COMMANDS[:1], outbox=(said,))))
    assert [batch.source.tolist() for batch in stand.barrier.sent] == [[0], [1], [2]]


def test_the_waiting_thread_wakes_when_replies_come_in_two_threads() -> None:
    barrier = barrier_of(MemoryNetwork().endpoint(), load(None, uavs=12))
    crowd = {f"agent-{uav}": Member(f"agent-{uav}", "agent", np.array([uav])) for uav in range(12)}
    waiting: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
    asked: queue.SimpleQueue[int | None] = queue.SimpleQueue()
    shuffle = np.random.default_rng(1).permutation

    def bring() -> None:
        while (number := asked.get()) is not None:
            for uav in shuffle(12):
                name = f"agent-{uav}"
                raw = tick.write_act(Act(FINGERPRINT, number, np.full((1, 5), float(uav + number))))
                if uav % 3 == 0 or not barrier.offer(keys.act(RUN, name), raw):  # every third is not offered
                    waiting.put((name, raw))

    thread = threading.Thread(target=bring)
    thread.start()
    try:
        for number in range(300):
            barrier.open(number, reporting=False)
            for member in crowd.values():
                barrier.ask(member, np.zeros((1, 4)))
            asked.put(number)
            while barrier.silent:
                name, raw = waiting.get(timeout=DEADLINE_S)
                barrier.take(crowd[name], raw)
            barrier.close()
            assert {name: act.commands[0, 0] for name, act in barrier.acts.items()} == {
                name: member.uavs[0] + number for name, member in crowd.items()
            }
    finally:
        asked.put(None)
        thread.join()
