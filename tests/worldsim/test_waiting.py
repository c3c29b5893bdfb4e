"""The time that a tick waits, on a clock of the test."""

import numpy as np

from meanflock.federation.post import Post
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import MemoryNetwork
from meanflock.swarm.scenario import load
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.members import Member
from meanflock.worldsim.replies import Replies
from meanflock.worldsim.waiting import Pace, Waiting

SCENARIO = load(None, uavs=3)


def losses(steps: list[float]) -> int:
    """How often the clock is looked at, in such steps and then 0.1 s, until a node that says nothing is lost."""
    now, looks = 0.0, 0
    barrier = Barrier(
        MemoryNetwork().endpoint(),
        "patience",
        Replies(SCENARIO, keys.fingerprint("patience"), Post(SCENARIO), lambda rows: 2**16),
    )
    barrier.open(0, reporting=False)
    barrier.ask(Member("agent-0", "agent", np.arange(1)), np.zeros((1, 4)))

    class Admission:
        def lose(self, member: Member, why: str) -> None:
            barrier.forget(member.name)

    def receive(timeout_s: float) -> None:
        nonlocal now, looks
        now += steps[looks] if looks < len(steps) else timeout_s
        looks += 1

    pace = Pace(load(None).pace, lambda kind, text: None, 2.0)
    Waiting(barrier, Admission(), None, None, 2.0, pace, receive, lambda: now).for_answers()  # type: ignore[arg-type]
    return looks


def test_a_silent_node_is_lost_when_the_patience_is_over() -> None:
    assert losses([]) in (20, 21)


def test_time_in_which_the_machine_stood_still_does_not_count() -> None:
    assert losses([60.0]) in (15, 16, 17)
