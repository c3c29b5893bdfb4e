"""The admission of the world: who comes, who goes, who comes back, and whether what they say is let in."""

import logging
import math
from collections.abc import Callable

import numpy as np

from meanflock.swarm import scenario
from meanflock.swarm.errors import BadInput, MessageRejected, RunFailed
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus, Delivery
from meanflock.swarm.net.identity import STATION
from meanflock.swarm.printable import printable
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Event, Join, Message, Ready, Received, Refusal, Stop, Welcome
from meanflock.swarm.wire.tick import TYPES
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.checkpoint import Resumption
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.limits import JOIN_BYTES, RECEIVED_BYTES, Limits
from meanflock.worldsim.members import LEADER, JoinRefused, Member, Members
from meanflock.worldsim.outbox import Outbox
from meanflock.worldsim.reporter import Note

log = logging.getLogger("meanflock.world")

MAX_DROP_EVENTS = 100  # the counters go on
MAX_EVENTS = 100  # of a node, and one more for each of its UAVs
_OF_REPEATS = ("duplicate", "stale")  # what a second answer to a question that was put twice is, in its tick or after


class Admission:
    """Takes every delivery of the world's bus; the members and the listeners of a run are its own."""

    def __init__(
        self,
        bus: Bus,
        run: str,
        members: Members,
        flight: Flight,
        barrier: Barrier,
        outbox: Outbox,
        counters: Counters,
        note: Note,
        clock: Callable[[], float],
    ) -> None:
        self.members = members
        self.listeners: set[str] = set()
        self.stations = 0  # recording listeners that must be there before the first tick
        self.flying = False  # from the first tick on; before it, who is lost is merely missing
        self.closed = False  # after the last: who leaves is not lost
        self.resumed: Resumption | None = None  # whose memory is handed out until then
        self.unfit: list[str] = []  # why nodes that were welcome cannot take part, after all
        self.unattended: dict[int, float] = {}  # UAVs whose agent was lost and that have no other yet: since when
        self.on_leader_lost: Callable[[], None] = lambda: None  # one that was asked in this tick
        flown = self._scenario = flight.scenario
        self._bus, self._run = bus, run
        self._fingerprint, self._received = keys.fingerprint(run), keys.received(run)
        self._float = control.FLOAT_OF_BITS[flown.radio.bits_per_float]
        self._plan = flight.states.astype(self._float)
        self._plugins, self._limits = flown.plugins(), Limits(flown)
        self._flight, self._barrier, self._outbox, self._counters = flight, barrier, outbox, counters
        self._note, self._clock = note, clock
        bus.subscribe(keys.act(run, "*"), barrier.offer)
        bus.subscribe(self._received)
        bus.watch(keys.alive(run, "*", "*"))
        bus.answer(keys.join(run))

    def handle(self, delivery: Delivery) -> None:
        """One delivery, whatever it is. Never raises for what the network sent."""
        try:
            if delivery.kind == "message" and delivery.key == self._received:
                received = control.decode_as(Received, delivery.payload, self._fingerprint, limit=RECEIVED_BYTES)
                self._outbox.acknowledge(received.block)
            elif delivery.kind == "message":
                self._hear(keys.node_of(delivery.key), delivery.payload)
            elif delivery.kind == "question":
                self._answer(delivery)
            elif delivery.kind == "oversized":
                if delivery.key != self._received:
                    keys.node_of(delivery.key)  # wrong-key, if it is no key of a node: nothing may come under it
                raise MessageRejected("oversized", f"{delivery.size} bytes, at most {delivery.largest} expected")
            else:
                self._presence(delivery)
        except MessageRejected as error:
            self.drop(error, delivery.key)

    def drop(self, error: MessageRejected, where: str) -> None:
        """Counts something that was not let in."""
        self._counters.drops[error.reason] += 1
        if self._counters.drops.total() <= MAX_DROP_EVENTS:  # a flood fills neither log nor record
            about = {"tick": self._flight.tick, "peer": _peer(where), "reason": error.reason}
            where = printable(where)
            log.warning("dropped a message under %s: %s", where, error, extra=about)
            self._note("dropped", f"{where}: {error}")

    def lose(self, member: Member, why: str) -> None:
        """A node is gone, or as good as gone: nobody waits for it any more, and if it still hears, it goes home."""
        if self.closed:
            self.members.lose(member)  # gone home
        if member.lost:
            return
        about = {"tick": self._flight.tick, "peer": member.name, "uavs": member.uavs.tolist(), "reason": why}
        log.warning("lost %s: %s", member.name, why, extra=about)
        self._counters.nodes_lost += self.flying
        self.dismiss(member, why, lost=True)
        if len(member.uavs) and self.flying:
            self.unattended |= dict.fromkeys(member.uavs.tolist(), self._clock())
            self._flight.lose(member.uavs, "lost", f"{member.name}: {why}")
        else:
            self._note("lost", f"{member.name}: {why}")

    def expel(self, name: str, why: str, out_s: float) -> None:
        """Loses a node, and lets nobody take its place for so many seconds."""
        member = self.members.get(name)
        assert member is not None
        self.lose(member, why)
        if out_s:
            self.members.shut(member, self._clock() + out_s, f"is lost: {why}")

    def dismiss(self, member: Member, why: str, lost: bool = False) -> None:
        """Sends a node home; its UAVs are free for another. `lost`: not because it has nothing left to do."""
        self.members.lose(member)
        self._stop(member.name, why, lost)
        if self._barrier.forget(member.name) and member.role == LEADER:
            self.on_leader_lost()

    def expire(self, patience_s: float) -> None:
        """Loses who was admitted during the flight and never became ready: nobody else could have its UAVs."""
        for member in self.members.present:
            if not member.ready and self._clock() - member.since_s > patience_s:
                self.lose(member, f"not ready after {patience_s:.0f} s")

    def settled(self, for_s: float) -> bool:
        """Whether no agent without a successor was lost within so many seconds: one may be on its way."""
        return self._clock() - max(self.unattended.values(), default=-math.inf) >= for_s

    @property
    def complete(self) -> bool:
        """Whether every UAV has its agent, the rounds their leader, and whoever records is there."""
        return self.members.complete and len(self.listeners) >= self.stations

    @property
    def missing(self) -> str:
        """Who is not there yet."""
        absent = self.stations - len(self.listeners)
        return ", ".join(filter(None, [self.members.missing(), f"{absent} ground station" if absent > 0 else ""]))

    def stop(self, why: str) -> None:
        """Sends every node home."""
        for member in self.members.present:
            self._stop(member.name, why)

    def check(self, late_s: float | None, cancelled: bool) -> None:
        """Everyone is sent home where the swarm will not be complete. `late_s`: the time that is over.

        Raises:
            BadInput: a node cannot take part. RunFailed: not in time, or interrupted; the message says who is missing.
        """
        if self.unfit:
            self.stop("a node cannot take part")
            raise BadInput(self.unfit[0])
        if cancelled:
            self.stop("interrupted")
            raise RunFailed(f"interrupted while waiting for {self.missing}")
        if late_s is not None:
            self.stop("the swarm is not complete")
            raise RunFailed(f"after {late_s:.0f} s the swarm still waits for {self.missing}")

    # -- messages -----------------------------------------------------------------------------------------------

    def _hear(self, name: str, raw: bytes) -> None:
        member = self.members.get(name)
        if member is None:
            raise MessageRejected("unknown-node", name)
        if member.lost:
            self._stop(name, "nobody waits for this node any more", lost=True)
            raise MessageRejected("unknown-node", f"{name}, which was lost")
        try:
            if len(raw) > (most := self._limits.act(member.rows)):
                raise MessageRejected("oversized", f"{len(raw)} bytes, at most {most} expected")
            if raw[1:2] in TYPES:
                self._barrier.take(member, raw)
            else:
                self._control(member, control.decode(raw))
        except MessageRejected as error:
            if error.reason not in _OF_REPEATS or not self._barrier.is_repeat(name):
                raise

    def _control(self, member: Member, message: Message) -> None:
        """What a node says beside its replies."""
        if getattr(message, "run", self._fingerprint) != self._fingerprint:
            raise MessageRejected("wrong-run", f"run {message.run:#x}, this is {self._fingerprint:#x}")  # type: ignore[union-attr]
        if isinstance(message, Ready):
            self._welcome(member)
        elif isinstance(message, Event):
            member.events += 1
            if member.events > MAX_EVENTS + member.rows:  # they are kept, here and on the ground
                raise MessageRejected("oversized", f"event {member.events} of a node, which may tell no more")
            self._note(member.role, f"{member.name}: {printable(message.text)}")
        elif isinstance(message, Refusal):
            self._refused(member, printable(message.reason))
        else:
            raise MessageRejected("wrong-kind", f"{type(message).__name__} from a node")

    def _refused(self, member: Member, why: str) -> None:
        """A node that was let in cannot take part. In flight its UAVs were lost before, and who watches is told why no
        other has them."""
        few, lost = len(self.unfit) < MAX_DROP_EVENTS, self._flight.lost[member.uavs]
        if few:
            self.unfit.append(why)
        self.lose(member, why)
        if few and len(lost) and lost.all():
            self._note("lost", f"{member.name}: {why}")

    def _welcome(self, member: Member) -> None:
        if self.closed:  # it was not there yet when all others were sent home
            self._stop(member.name, "finished")
            return
        if member.ready:
            return
        member.ready = True
        self._counters.nodes_rejoined += self.flying
        for uav in member.uavs.tolist():
            self.unattended.pop(uav, None)
        if self.flying and member.role == LEADER:
            self._note("rejoined", f"{member.name} stands by")
        elif self.flying:
            self._flight.rejoin(member.uavs, member.name)
        if self.flying and self.members.rejoined(member, self._flight.tick, self._scenario.pace):
            text = f"{member.name} rejoined for the last time: nobody may take its place again"
            log.warning(text, extra={"tick": self._flight.tick, "peer": member.name})
            self._note("refused", text)

    # -- questions ----------------------------------------------------------------------------------------------

    def _answer(self, delivery: Delivery) -> None:
        assert delivery.reply is not None
        join = control.decode(delivery.payload, limit=JOIN_BYTES)
        if not isinstance(join, Join):
            raise MessageRejected("wrong-kind", f"{type(join).__name__} as a question")
        if keys.node_of(delivery.key) != (asker := keys.asker(join.role, join.uav)):
            raise MessageRejected("wrong-name", f"a Join of {asker}")
        if self.closed and join.role != STATION:  # who records may still fetch what waits
            delivery.reply(control.encode(Refusal("the flight is over", over=True)))
            return
        name, uavs = STATION, np.zeros(0, dtype=np.intp)  # a ground station asks what is flown, and for what it missed
        if join.role == STATION:
            self._outbox.rewind()
        else:
            try:
                member = self.members.admit(join, self._clock())
            except JoinRefused as error:
                delivery.reply(control.encode(Refusal(str(error), error.for_now)))
                return
            name, uavs = member.name, member.uavs
            about = {"tick": self._flight.tick, "peer": name, "uavs": uavs.tolist()}
            log.info("%s joined with UAVs %s", name, uavs.tolist(), extra=about)
        past = self.resumed if not self.flying and len(uavs) else None
        delivery.reply(
            control.encode(
                Welcome(
                    run=self._fingerprint,
                    node=name,
                    uavs=tuple(uavs.tolist()),
                    tick=self._flight.tick,
                    scenario=scenario.encode(self._scenario if name == STATION else self._scenario.known()),
                    initial_states=self._plan,
                    memory=b"" if past is None else past.memory(uavs),
                    plugins=self._plugins,
                )
            )
        )

    # -- liveliness ---------------------------------------------------------------------------------------------

    def _presence(self, delivery: Delivery) -> None:
        role, name = keys.presence_of(delivery.key)
        if role == STATION:
            if delivery.kind == "alive":
                self.listeners.add(name)
                self._outbox.rewind()
            else:
                self.listeners.discard(name)
            return
        member = self.members.get(name)
        if member is None:
            return
        if delivery.kind == "gone":
            self.lose(member, "its liveliness token vanished")
        elif member.lost:
            self._stop(name, "nobody waits for this node any more", lost=True)

    def _stop(self, name: str, why: str, lost: bool = False) -> None:
        why = f"lost: {why}" if lost else why
        self._bus.put(keys.sense(self._run, name), control.encode(Stop(self._fingerprint, why, lost)))


def _peer(where: str) -> str:
    """The node a key or a text names, or the text itself where it is no key of a node."""
    try:
        return keys.node_of(where)
    except MessageRejected:
        return printable(where)
