"""The barrier of a tick: requests to the nodes with their frames; replies, validated as they are read, and merged."""

import threading
import time
from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.ledger import Ledger
from meanflock.federation.plan import Plan
from meanflock.federation.seat import order_of_seats
from meanflock.net import keys
from meanflock.net import tick as wire
from meanflock.net.bus import Bus
from meanflock.net.members import LEADER, Member
from meanflock.swarm.declared import MAX_BROADCASTS
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.state import Floats, States, contains
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense


class Replies:
    """Reader of the Acts of a run. Nothing behind it checks a reply's size, shape or sender again."""

    def __init__(self, plan: Plan, run: int, ledger: Ledger, longest: Callable[[int], int]) -> None:
        """`run`: the run's fingerprint. `longest`: most bytes of the Act of a node with so many UAVs."""
        declared, scenario = plan.declared, plan.scenario
        self._scenario = scenario
        self._run = run
        self._ledger = ledger
        self._longest = longest
        self._columns = scenario.dimensions + len(declared.diagnostics)
        self._weights = declared.weights
        self._broadcast_numbers = declared.broadcast_numbers
        self._float = FLOAT_OF_BITS[scenario.radio.bits_per_float]
        self._seats = np.sort(order_of_seats(scenario))

    def table(self) -> Floats:
        """Zeros of the shape (N, 2 + K) of the numbers of all UAVs in a tick."""
        return np.zeros((self._scenario.uavs, self._columns))

    def read(self, member: Member, tick: int, raw: bytes, into: Floats | None = None) -> Act:
        """Read and validate the Act of a node that replies to the request of a tick.

        `into`: (N, 2 + K), where the node's numbers are written, even if the Act is then rejected; None: nowhere.

        Raises:
            MessageRejected: not a valid Act of this node; the reasons are those of `errors.MessageRejected`.
        """
        if len(raw) > (longest := self._longest(member.rows)):
            raise MessageRejected("oversized", f"{len(raw)} bytes, at most {longest} expected")
        rows = np.zeros((member.rows, self._columns)) if into is None else into[member.place]
        act = wire.read_act(raw, rows)
        if into is not None and not isinstance(member.place, slice):
            into[member.place] = rows
        if act.run != self._run:
            raise MessageRejected("wrong-run", f"run {act.run:#x}, this is {self._run:#x}")
        if act.tick != tick:
            raise MessageRejected("stale", f"reply to tick {act.tick} in tick {tick}")
        if act.models is not None and act.models.shape[1] != self._weights:
            raise MessageRejected(
                "wrong-shape", f"models: expected {(member.rows, self._weights)}, got {act.models.shape}"
            )
        if len(act.refused_uploads):
            self._check_named(act.refused_uploads)
            self._ledger.check_refused(member.role, tick, act.refused_uploads, member.uavs)
        if len(act.refused_states):
            self._check_refused_states(member, act.refused_states)
        for name, uavs in (("lost", act.lost), ("waiting", act.waiting)):
            if len(uavs) and not contains(member.uavs, uavs).all():
                raise MessageRejected("wrong-shape", f"{name} names UAVs of another node")
        if len(act.waiting):
            self._ledger.check_waiting(tick, act.waiting)
        if act.outbox:
            self._check_outbox(member, act.outbox)
        return act

    def _check_refused_states(self, member: Member, uavs: NDArray[np.int32]) -> None:
        self._check_named(uavs)
        if member.role == LEADER:
            raise MessageRejected("wrong-shape", "a leader receives no states")
        if member.rows == 1 and contains(member.uavs, uavs).any():
            raise MessageRejected("wrong-shape", "refused names the node's own UAV")

    def _check_named(self, uavs: NDArray[np.int32]) -> None:
        if len(np.unique(uavs)) < len(uavs) or not ((uavs >= 0) & (uavs < self._scenario.uavs)).all():
            raise MessageRejected("wrong-shape", "refused names UAVs that are not there, or one twice")

    def _check_outbox(self, member: Member, outbox: tuple[Frames, ...]) -> None:
        if len(outbox) > 1:
            batches = {(frames.kind, frames.round if frames.kind == FrameKind.STATE else 0) for frames in outbox}
            if len(batches) != len(outbox) or len(outbox) > MAX_BROADCASTS + len(FrameKind):
                raise MessageRejected("wrong-shape", "two batches of one kind in one outbox, or too many")
        for frames in outbox:
            self._check_frames(member, frames)

    def _check_frames(self, member: Member, frames: Frames) -> None:
        kind = frames.kind
        source = frames.source
        payload = frames.payload
        if kind != FrameKind.STATE:
            self._ledger.check(member.role, frames)
        elif member.role == LEADER:
            raise MessageRejected("wrong-kind", f"{kind.name} frames from {member.name}")
        else:
            if payload.dtype.kind == "f" and payload.dtype != self._float:
                raise MessageRejected("wrong-shape", f"payload: expected floats {self._float}, got {payload.dtype}")
            if not 0 < payload.shape[1] <= self._broadcast_numbers or frames.round >= MAX_BROADCASTS:
                raise MessageRejected("wrong-shape", f"broadcast {frames.round} of {payload.shape[1]} numbers")
        own = self._seats if member.role == LEADER else member.uavs
        of_uavs = contains(own, source).all() if kind != FrameKind.STATE else _ascending_part(own, source)
        if not len(source) or not (_equal(own, source) or of_uavs):
            raise MessageRejected("wrong-shape", f"frames of {member.name} name UAVs {source.tolist()}")
        if frames.links is not None:
            raise MessageRejected("wrong-shape", "only the world says which links carried a frame")


def _equal(own: NDArray[np.intp], source: NDArray[np.int32]) -> bool:
    # `np.array_equal` takes twice as long.
    return len(own) == len(source) and bool(np.logical_and.reduce(own == source))


def _ascending_part(own: NDArray[np.intp], source: NDArray[np.int32]) -> bool:
    return bool(contains(own, source).all() and (source[1:] > source[:-1]).all())


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
            states: (M, 4), the states of its UAVs.
            received: the frames that reached it.
            checkpoint: whether the reply must contain the memory of the controller.
            memory: a record: of a new leader, the state of the aggregation rule; of others, the goals that change.
        """
        report = self.reporting and len(states) > 0
        request = wire.write_sense(Sense(self._fingerprint, self._tick, states, report, checkpoint, received, memory))
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
        """Returns whether an unexpected reply answers a repeated request: true once for each repeated request."""
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
