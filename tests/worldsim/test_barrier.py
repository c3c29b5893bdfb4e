"""The barrier: commands stand in the rows of their UAVs, and the waiting thread wakes at the last reply."""

import queue
import threading

import numpy as np

from meanflock.federation.post import Post
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import MemoryNetwork
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire import tick
from meanflock.swarm.wire.messages import Act
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.limits import Limits
from meanflock.worldsim.members import Member
from meanflock.worldsim.replies import Replies
from tests.polling import DEADLINE_S

RUN = "fence"
FINGERPRINT = keys.fingerprint(RUN)
TICK = 300
COMMANDS = np.arange(10.0).reshape(2, 5)


def barrier_of(flown: Scenario) -> Barrier:
    return Barrier(MemoryNetwork().endpoint(), RUN, Replies(flown, FINGERPRINT, Post(flown), Limits(flown).act))


def test_commands_are_in_the_rows_of_uavs_that_do_not_follow_each_other() -> None:
    barrier = barrier_of(load(None, uavs=5))
    member = Member("agent-1", "agent", np.array([1, 4]))
    barrier.open(TICK, reporting=False)
    barrier.ask(member, np.zeros((2, 4)))
    barrier.take(member, tick.write_act(Act(FINGERPRINT, TICK, COMMANDS)))
    assert (barrier.commands[[1, 4]] == COMMANDS).all()
    assert barrier.replied.tolist() == [False, True, False, False, True]


def test_the_waiting_thread_wakes_when_replies_come_in_two_threads() -> None:
    barrier = barrier_of(load(None, uavs=12))
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
