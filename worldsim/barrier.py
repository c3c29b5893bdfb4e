"""The barrier of a tick: requests to the nodes with their frames; replies, validated as they are read, and merged."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.meter import Meter
from meanflock.federation.mailbox import links_of, only
from meanflock.federation.post import Post
from meanflock.swarm import state
from meanflock.swarm.declared import MAX_BROADCASTS
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import BEYOND_SENSE, Floats, Mask, States, contains
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense
from meanflock.worldsim.books import block_ticks, sums
from meanflock.worldsim.members import LEADER, Member

_NOBODY = np.zeros(0, dtype=np.intp)


class Replies:
    """Reader of the Acts of a run. Nothing behind it checks a reply's size, shape or sender again."""

    def __init__(self, scenario: Scenario, run: int, post: Post, longest: Callable[[int], int]) -> None:
        """`run`: the run's fingerprint. `longest`: most bytes of the Act of a node with so many UAVs."""
        declared = scenario.declared
        self._scenario = scenario
        self._run = run
        self._post = post
        self._longest = longest
        self._columns = state.AXES + len(declared.diagnostics)
        self._weights = declared.weights
        self._broadcast_numbers = declared.broadcast_numbers
        self._float = FLOAT_OF_BITS[scenario.radio.bits_per_float]
        self._leader = np.array([scenario.federation.leader])

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
        if len(act.refused):
            self._check_refused(member, tick, act.refused)
        if len(act.lost) and not contains(member.uavs, act.lost).all():
            raise MessageRejected("wrong-shape", "lost names UAVs of another node")
        if act.outbox:
            self._check_outbox(member, act.outbox)
        return act

    def _check_refused(self, member: Member, tick: int, refused: NDArray[np.int32]) -> None:
        """Negative numbers name uploads (~UAV), which only a node that averages may refuse; the others name states."""
        uavs = self._scenario.uavs
        if len(np.unique(refused)) < len(refused) or not ((refused >= -uavs) & (refused < uavs)).all():
            raise MessageRejected("wrong-shape", "refused names UAVs that are not there, or one twice")
        uploads = ~refused[refused < 0]
        states = refused[refused >= 0]
        if member.role == LEADER and len(states):
            raise MessageRejected("wrong-shape", "a leader receives no states")
        if len(uploads):
            self._post.check_refused(member.role, tick, uploads, member.uavs)
        if member.rows == 1 and contains(member.uavs, states).any():
            raise MessageRejected("wrong-shape", "refused names the node's own UAV")

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
            self._post.check(member.role, frames)
        elif member.role == LEADER:
            raise MessageRejected("wrong-kind", f"{kind.name} frames from {member.name}")
        else:
            if payload.dtype.kind == "f" and payload.dtype != self._float:
                raise MessageRejected("wrong-shape", f"payload: expected floats {self._float}, got {payload.dtype}")
            if not 0 < payload.shape[1] <= self._broadcast_numbers or frames.round >= MAX_BROADCASTS:
                raise MessageRejected("wrong-shape", f"broadcast {frames.round} of {payload.shape[1]} numbers")
        own = self._leader if member.role == LEADER else member.uavs
        if not len(source) or not (_equal(own, source) or _ascending_part(own, source)):
            raise MessageRejected("wrong-shape", f"frames of {member.name} name UAVs {source.tolist()}")
        if frames.links is not None:
            raise MessageRejected("wrong-shape", "only the world says which links carried a frame")


def _equal(own: NDArray[np.intp], source: NDArray[np.int32]) -> bool:
    # `np.array_equal` takes twice as long.
    return len(own) == len(source) and bool(np.logical_and.reduce(own == source))


def _ascending_part(own: NDArray[np.intp], source: NDArray[np.int32]) -> bool:
    return bool(contains(own, source).all() and (source[1:] > source[:-1]).all())


class Commands:
    """The current command of each UAV, and the diagnostics of the flight.

    Diagnostics are added up for a block of ticks at once, in the order of the ticks.

    Attributes:
        accelerations: (N, 2), m/s², of the controllers. The row of a UAV without a reply stays.
        steered: (N, 2), m/s², what is flown in their place if a client steers; None if none can.
        diagnostics: (N, K), of the last tick. The row of a UAV without a reply is 0.
    """

    def __init__(self, uavs: int, diagnostics: int) -> None:
        self.accelerations: state.Plane = np.zeros((uavs, state.AXES))
        self.steered: state.Plane | None = None
        self.diagnostics: Floats = np.zeros((uavs, diagnostics))
        self._most = block_ticks(uavs)
        self._largest: Floats = np.zeros(diagnostics)
        self._summed: Floats = np.zeros(diagnostics)
        self._block: list[Floats] = []  # diagnostics of ticks that are not in the sums yet
        self._on_way: Mask = np.zeros(uavs, dtype=bool)  # in these ticks

    @property
    def flown(self) -> state.Plane:
        """(N, 2), m/s², the commands that the UAVs fly."""
        return self.accelerations if self.steered is None else self.steered

    @property
    def largest(self) -> Floats:
        """(K,), maximum of |diagnostics| over the flight."""
        self._settle()
        return self._largest

    @property
    def summed(self) -> Floats:
        """(K,), sum of the diagnostics of UAVs on the way over the flight."""
        self._settle()
        return self._summed

    def store(self, numbers: Floats, replied: Mask, awake: Mask, on_way: Mask) -> NDArray[np.intp]:
        """Store the numbers (N, 2 + K) of the UAVs that replied and are awake.

        Args:
            numbers: of the replies, finite; never written to again.
            replied: (N,), UAVs whose node replied.
            awake: (N,), UAVs that take part in the tick.
            on_way: (N,), UAVs that have left the ground, have not arrived and are not lost; a new array if others have.

        Returns:
            The UAVs that replied with a diverged number; their rows are not stored.
        """
        stored = replied & awake
        diverged = _NOBODY
        if b"\0" in stored.tobytes() or not np.maximum.reduce(np.abs(numbers), axis=None, initial=0.0) < BEYOND_SENSE:
            bounded = np.logical_and.reduce(np.abs(numbers) < BEYOND_SENSE, axis=1)
            stored &= bounded
            diverged = np.flatnonzero(replied & ~bounded)
            np.copyto(self.accelerations, numbers[:, : state.AXES], where=stored[:, None])
            numbers = np.where(stored[:, None], numbers, 0.0)
        else:
            self.accelerations[...] = numbers[:, : state.AXES]
        self.diagnostics = numbers[:, state.AXES :]
        if on_way is not self._on_way or len(self._block) == self._most:
            self._settle()
            self._on_way = on_way
        self._block.append(self.diagnostics)
        return diverged

    def _settle(self) -> None:
        """Add the diagnostics of the ticks since the last call to the sums."""
        if not self._block:
            return
        block = np.stack(self._block)  # (k, N, K)
        self._block = []
        sizes = np.abs(block.transpose(2, 0, 1), order="C")  # much faster than a maximum along few columns
        self._largest = np.maximum(self._largest, np.maximum.reduce(sizes, axis=(1, 2)))
        of_ticks = np.add.reduce(block.take(self._on_way.nonzero()[0], axis=1), axis=1)
        self._summed = sums(self._summed, of_ticks)[-1]


class FrameMerger:
    """Joins the frames of a tick by kind, broadcast number and form; drops those that may not be sent now."""

    def __init__(self, post: Post, drop: Callable[[MessageRejected, str], None]) -> None:
        """`drop`: counts a batch that is dropped."""
        self._post = post
        self._drop = drop

    def merged(self, tick: int, sent: Iterable[Frames], awake: Mask, meter: Meter) -> list[Frames]:
        """The joined frames of a tick.

        Args:
            sent: one batch for each node, kind and broadcast, nodes in order of their UAVs.
            awake: (N,), UAVs that may send.
            meter: counts the bytes of the batches.
        """
        alike: dict[tuple[int, int, str, int], list[Frames]] = {}
        for batch in sent:
            broadcast = batch.round if batch.kind == FrameKind.STATE else 0
            form = batch.kind, broadcast, batch.payload.dtype.str, batch.payload.shape[1]
            alike.setdefault(form, []).append(batch)
        # Sorted by form, so that the order does not depend on how UAVs are divided among processes.
        ordered = [alike[form] for form in sorted(alike)] if len(alike) > 1 else alike.values()
        return [frames for batches in ordered if (frames := self._joined(tick, batches, awake, meter))]

    def _joined(self, tick: int, batches: list[Frames], awake: Mask, meter: Meter) -> Frames | None:
        if batches[0].kind != FrameKind.STATE:
            batches = self._in_round(tick, batches)
        if b"\0" in awake.tobytes():  # faster than awake.all()
            batches = [part for batch in batches if (part := _by_awake(batch, awake)) is not None]
        for batch in batches:
            meter.wire(batch.kind, wire.bytes_of_batch(batch))
        return _join(batches) if batches else None

    def _in_round(self, tick: int, batches: list[Frames]) -> list[Frames]:
        """The batches that belong to a round that transmits in this tick, each UAV once."""
        accepted: list[Frames] = []
        senders: set[int] = set()
        for batch in batches:
            uavs = batch.source.tolist()
            error = self._post.round_error(batch, tick)
            if error is None and not senders.isdisjoint(uavs):
                error = MessageRejected("duplicate", f"two {batch.kind.name} frames of one UAV")
            if error is None:
                accepted.append(batch)
                senders.update(uavs)
            else:
                self._drop(error, f"frames of UAV {uavs[0]}")
        return accepted


def _by_awake(batch: Frames, awake: Mask) -> Frames | None:
    """The frames of UAVs that are awake; None if there are none."""
    sending = awake[batch.source]
    if sending.all():
        return batch
    return Frames(batch.kind, batch.round, batch.source[sending], batch.payload[sending]) if sending.any() else None


def _join(batches: list[Frames]) -> Frames:
    """One batch of all frames of batches of one kind and round."""
    if len(batches) == 1:
        return batches[0]
    source = np.concatenate([batch.source for batch in batches])
    return Frames(batches[0].kind, batches[0].round, source, np.concatenate([batch.payload for batch in batches]))


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
            memory: state of the aggregation rule, for a new leader.
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


def reaching(due: Iterable[Frames], awake: NDArray[np.bool_]) -> list[Frames]:
    """The frames `due` in this tick, reduced to links that end at UAVs that are `awake` (N,)."""
    if awake.all():
        return list(due)
    arrived = []
    for batch in due:
        links = links_of(batch)
        links = links[awake[links[:, 1]]]
        if len(links):
            arrived.append(only(batch, links))
    return arrived


def received_by(member: Member, arrived: Iterable[Frames], uavs: int) -> tuple[Frames, ...]:
    """The part for one agent of the frames that `arrived` at all `uavs` UAVs: its links, and the payloads on them."""
    own = []
    for batch in arrived:
        links = links_of(batch)
        if member.rows < uavs:
            targets = links[:, 1]
            links = links[targets == member.uavs[0] if member.rows == 1 else contains(member.uavs, targets)]
        if len(links):
            own.append(only(batch, links))
    return tuple(own)
