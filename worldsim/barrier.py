"""The barrier of a tick: who was asked, what was asked, and who has replied."""

import threading
import time
from collections import Counter
from collections.abc import Callable

import numpy as np

from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus
from meanflock.swarm.state import States
from meanflock.swarm.wire import tick
from meanflock.swarm.wire.messages import Act, Frames, Sense
from meanflock.worldsim.inbound import Replies
from meanflock.worldsim.members import Member


class Barrier:
    """The requests of one tick after the other.

    A reply is taken in whatever thread brings it; all that does not fit is left to the thread of the world.
    """

    def __init__(self, bus: Bus, run: str, replies: Replies, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock`: seconds, monotonic."""
        self._bus, self._run, self._fingerprint = bus, run, keys.fingerprint(run)
        self._replies, self._clock = replies, clock
        self._requests: dict[str, bytes] = {}  # by name
        self._silent: dict[str, Member] = {}  # who has yet to reply, by the key of the reply
        self._gate = threading.RLock()  # of that and of the replies
        self._repeats: Counter[str] = Counter()  # second replies that may still come, by the node's name
        self._tick, self.reporting = -1, False
        self.asked: dict[str, Member] = {}
        self.acts: dict[str, Act] = {}  # of whoever has replied
        self.commands = replies.table()  # (N, 2 + K), in the rows of the UAVs whose node has
        self._nobody = np.zeros(len(self.commands), dtype=bool)
        self.replied = self._nobody  # (N,), which these are
        self.standing = False  # between the first request of a tick and the last reply
        self.asked_at = 0.0  # when the requests of a tick began, by the clock
        self.settled: list[tuple[float, Member]] = []  # when each node replied since or was given up, in order

    def open(self, number: int, reporting: bool) -> None:
        """A new tick, in which agents report what they have learned or not: nobody is asked yet."""
        with self._gate:
            self._tick, self.reporting = number, reporting
            self.asked, self.acts, self._requests, self._silent = {}, {}, {}, {}
            self.commands, self.replied = self.commands.copy(), self._nobody.copy()
            self.standing, self.asked_at, self.settled = True, self._clock(), []

    def close(self) -> None:
        """The tick waits for nobody any more; what comes now is late."""
        with self._gate:
            self.standing = False
            self._silent = {}

    def ask(
        self,
        member: Member,
        states: States,
        received: tuple[Frames, ...] = (),
        checkpoint: bool = False,
        memory: bytes = b"",
    ) -> None:
        """Asks a node, which has these states and received these frames, and expects its reply.

        `checkpoint`: it is to reply with all that a checkpoint keeps. `memory`: of the aggregation, for a new leader.
        """
        report = self.reporting and len(states) > 0
        request = tick.write_sense(Sense(self._fingerprint, self._tick, states, report, checkpoint, received, memory))
        name = member.name
        with self._gate:
            self.asked[name] = self._silent[keys.act(self._run, name)] = member
            self._requests[name] = request
        self._bus.put(keys.sense(self._run, name), request)

    def ask_again(self) -> None:
        """Repeats every request nobody replied to yet."""
        for name in self.missing:
            self._repeats[name] += 1
            self._bus.put(keys.sense(self._run, name), self._requests[name])

    def offer(self, key: str, raw: bytes) -> bool:
        """Takes a reply that is waited for, whoever brings it; whatever else this is is left to be received, and so is
        the last reply: who waits for it would not wake otherwise.
        """
        with self._gate:
            member = self._silent.get(key)
            if member is None or len(self._silent) == 1:
                return False
            try:
                self._store(member, self._replies.read(member, self._tick, raw, self.commands), key)
            except MessageRejected:  # the world's thread counts it
                return False
            return True

    def take(self, member: Member, raw: bytes) -> None:
        """Takes a reply.

        Raises:
            MessageRejected: it is none, or does not fit; `duplicate`: the node was not asked, or has replied.
        """
        key = keys.act(self._run, member.name)
        with self._gate:
            if key not in self._silent:
                act = self._replies.read(member, self._tick, raw)
                raise MessageRejected("duplicate", f"second reply of {member.name} to tick {act.tick}")
            self._store(member, self._replies.read(member, self._tick, raw, self.commands), key)

    def _store(self, member: Member, act: Act, key: str) -> None:
        self.acts[member.name] = act
        self.replied[member.place] = True
        self.settled.append((self._clock(), member))
        del self._silent[key]

    def is_repeat(self, name: str) -> bool:
        """Whether a reply of a node that is not waited for is that to a request that was repeated, for which it cannot
        be blamed; true once for every such request.
        """
        if is_due := self._repeats[name] > 0:
            self._repeats[name] -= 1
        return is_due

    def forget(self, name: str) -> bool:
        """A node is gone: what it replied in this tick counts no more. Returns whether it had been asked."""
        with self._gate:
            if (waited_for := self._silent.pop(keys.act(self._run, name), None)) is not None:
                self.settled.append((self._clock(), waited_for))
            self._repeats.pop(name, None)
            self.acts.pop(name, None)
            if (member := self.asked.pop(name, None)) is not None:
                self.replied[member.place] = False
            return member is not None

    @property
    def sent(self) -> list[Frames]:
        """What everyone sends by radio, in the order in which they were asked."""
        acts = self.acts
        return [batch for name in self.asked if name in acts for batch in acts[name].outbox]

    @property
    def missing(self) -> list[str]:
        """Who has not replied."""
        with self._gate:
            return [member.name for member in self._silent.values()]

    @property
    def silent(self) -> int:
        """How many that is; nobody, where the tick is complete."""
        return len(self._silent)
