"""The barrier of a tick: the requests to the nodes, the frames that go with them, and the replies that have come."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.mailbox import only
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus
from meanflock.swarm.state import States, contains
from meanflock.swarm.wire import tick
from meanflock.swarm.wire.messages import Act, Frames, Sense
from meanflock.worldsim.members import Member
from meanflock.worldsim.replies import Replies


class Barrier:
    """Requests and replies of the current tick.

    A reply may arrive in any thread. The thread of the bus stores it at once (`offer`); what it cannot store goes to
    the world's thread (`take`).

    Attributes:
        asked: the nodes that were asked, by name.
        acts: the replies so far, by name.
        commands: (N, 2 + K), numbers of the replies, in the rows of their UAVs.
        replied: (N,), mask of the UAVs whose node has replied.
        reporting: whether agents report their models in this tick.
        standing: whether replies are taken; true from the opening of a tick to its close.
        asked_at: when the tick was opened, by the clock.
        settled: (time, node) of each reply or loss since then, in order.
    """

    def __init__(self, bus: Bus, run: str, replies: Replies, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock`: seconds, monotonic."""
        self._bus = bus
        self._run = run
        self._fingerprint = keys.fingerprint(run)
        self._replies = replies
        self._clock = clock
        self._gate = threading.RLock()  # guards _silent and all that a reply changes
        self._silent: dict[str, Member] = {}  # nodes that have yet to reply, by the key of the reply
        self._requests: dict[str, bytes] = {}  # by name
        self._repeats: Counter[str] = Counter()  # second replies that may still come, by name
        self._tick = -1
        self.reporting = False
        self.asked: dict[str, Member] = {}
        self.acts: dict[str, Act] = {}
        self.commands = replies.table()
        self._no_uav = np.zeros(len(self.commands), dtype=bool)
        self.replied = self._no_uav
        self.standing = False
        self.asked_at = 0.0
        self.settled: list[tuple[float, Member]] = []

    def open(self, number: int, reporting: bool) -> None:
        """Begin a tick: no node has been asked yet."""
        with self._gate:
            self._tick = number
            self.reporting = reporting
            self.asked = {}
            self.acts = {}
            self._requests = {}
            self._silent = {}
            self.commands = self.commands.copy()
            self.replied = self._no_uav.copy()
            self.standing = True
            self.asked_at = self._clock()
            self.settled = []

    def close(self) -> None:
        """End the wait: replies that come from now on are late."""
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
        """Send a node its request and expect its reply.

        Args:
            member: the node.
            states: (M, 4), the states of its UAVs.
            received: the frames that reached it.
            checkpoint: whether the reply must contain the memory of the controller.
            memory: state of the aggregation rule, for a new leader.
        """
        report = self.reporting and len(states) > 0
        request = tick.write_sense(Sense(self._fingerprint, self._tick, states, report, checkpoint, received, memory))
        name = member.name
        with self._gate:
            self.asked[name] = self._silent[keys.act(self._run, name)] = member
            self._requests[name] = request
        self._bus.put(keys.sense(self._run, name), request)

    def ask_again(self) -> None:
        """Repeat every request that has no reply yet."""
        for name in self.missing:
            self._repeats[name] += 1
            self._bus.put(keys.sense(self._run, name), self._requests[name])

    def offer(self, key: str, raw: bytes) -> bool:
        """Store an expected reply, in the thread that brings it; returns whether it was stored.

        The last reply of a tick is left to the world's thread, which would not wake otherwise; so is a reply that
        is rejected, because that thread counts it.
        """
        with self._gate:
            member = self._silent.get(key)
            if member is None or len(self._silent) == 1:
                return False
            try:
                self._store(member, key, raw)
            except MessageRejected:
                return False
            return True

    def take(self, member: Member, raw: bytes) -> None:
        """Store a reply, in the world's thread.

        Raises:
            MessageRejected: not a valid reply; `duplicate`: the node was not asked, or has replied.
        """
        key = keys.act(self._run, member.name)
        with self._gate:
            if key not in self._silent:
                act = self._replies.read(member, self._tick, raw)
                raise MessageRejected("duplicate", f"second reply of {member.name} to tick {act.tick}")
            self._store(member, key, raw)

    def _store(self, member: Member, key: str, raw: bytes) -> None:
        self.acts[member.name] = self._replies.read(member, self._tick, raw, self.commands)
        self.replied[member.place] = True
        self.settled.append((self._clock(), member))
        del self._silent[key]

    def is_repeat(self, name: str) -> bool:
        """Whether an unexpected reply answers a repeated request. True once for each repeated request of a node."""
        if is_due := self._repeats[name] > 0:
            self._repeats[name] -= 1
        return is_due

    def forget(self, name: str) -> bool:
        """Discard the request and the reply of a node that is lost; returns whether it had been asked."""
        with self._gate:
            if (silent := self._silent.pop(keys.act(self._run, name), None)) is not None:
                self.settled.append((self._clock(), silent))
            self._repeats.pop(name, None)
            self.acts.pop(name, None)
            if (member := self.asked.pop(name, None)) is not None:
                self.replied[member.place] = False
            return member is not None

    @property
    def sent(self) -> list[Frames]:
        """The frames of all replies, in the order in which the nodes were asked."""
        acts = self.acts
        return [batch for name in self.asked if name in acts for batch in acts[name].outbox]

    @property
    def missing(self) -> list[str]:
        """Names of the nodes that have yet to reply."""
        with self._gate:
            return [member.name for member in self._silent.values()]

    @property
    def silent(self) -> int:
        """Number of nodes that have yet to reply."""
        return len(self._silent)


def reaching(due: Iterable[Frames], awake: NDArray[np.bool_]) -> list[Frames]:
    """The frames `due` in this tick, reduced to links that end at UAVs that are `awake` (N,)."""
    arrived = [batch for batch in due if batch.links is not None]
    if arrived and not awake.all():
        arrived = [only(batch, batch.links[awake[batch.links[:, 1]]]) for batch in arrived if batch.links is not None]
    return [batch for batch in arrived if batch.links is not None and len(batch.links)]


def received_by(member: Member, arrived: Iterable[Frames], uavs: int) -> tuple[Frames, ...]:
    """The part for one agent of the frames that `arrived` at all `uavs` UAVs: its links, and the payloads on them."""
    own = []
    for batch in arrived:
        assert batch.links is not None
        links = batch.links
        if member.rows < uavs:
            targets = links[:, 1]
            links = links[targets == member.uavs[0] if member.rows == 1 else contains(member.uavs, targets)]
        if len(links):
            own.append(only(batch, links))
    return tuple(own)
