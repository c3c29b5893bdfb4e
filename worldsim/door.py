"""The door of the world: who comes, who goes, who comes back, and whether what they say is let in."""

import logging
from collections.abc import Callable

import numpy as np

from swarm import codec, keys, scenario
from swarm.bus import Bus, Delivery
from swarm.errors import MessageRejected
from swarm.messages import Event, Join, Message, Ready, Received, Refusal, Stop, Welcome
from swarm.scenario import Scenario
from swarm.tick import TYPES
from worldsim import inbound
from worldsim.barrier import Barrier
from worldsim.checkpoint import Resumption
from worldsim.flight import Flight
from worldsim.ledger import Ledger
from worldsim.members import LEADER, JoinRefused, Member, Members
from worldsim.telemetry import Outbox

log = logging.getLogger("meanflock.world")

STATION = "station"
MAX_TEXT = 500  # of what a node says of itself
MAX_DROP_EVENTS = 100  # the counters go on
_OF_REPEATS = ("duplicate", "stale")  # what a second answer to a question that was put twice is, in its tick or after

Note = Callable[[str, str], None]  # kind and text of an event


class Door:
    """Takes every delivery of the world's bus; the members and the listeners of a run are its own."""

    def __init__(
        self,
        flown: Scenario,
        bus: Bus,
        run: str,
        members: Members,
        flight: Flight,
        barrier: Barrier,
        outbox: Outbox,
        ledger: Ledger,
        note: Note,
        clock: Callable[[], float],
    ) -> None:
        self.members = members
        self.listeners: set[str] = set()
        self.flying = False  # from the first tick on; before it, who is lost is merely missing
        self.closed = False  # after the last: who leaves is not lost
        self.resumed: Resumption | None = None  # whose memory is handed out until then
        self.unfit: list[str] = []  # why nodes that were welcome cannot take part, after all
        self.on_leader_lost: Callable[[], None] = lambda: None  # one that was asked in this tick
        self._scenario, self._bus, self._run = flown, bus, run
        self._fingerprint, self._received = keys.fingerprint(run), keys.received(run)
        self._float = codec.FLOAT_OF_BITS[flown.radio.bits_per_float]
        self._plan = flight.states.astype(self._float)
        self._plugins = flown.plugins()
        self._flight, self._barrier, self._outbox, self._ledger = flight, barrier, outbox, ledger
        self._note, self._clock = note, clock
        bus.subscribe(keys.act(run, "*"), barrier.offer)
        bus.subscribe(self._received)
        bus.watch(keys.alive(run, "*", "*"))
        bus.answer(keys.join(run))

    def handle(self, delivery: Delivery) -> None:
        """One delivery, whatever it is. Never raises for what the network sent."""
        try:
            if delivery.kind == "message" and delivery.key == self._received:
                received = codec.decode_as(Received, delivery.payload, self._fingerprint, limit=64)
                self._outbox.acknowledge(received.block)
            elif delivery.kind == "message":
                self._hear(keys.node_of(delivery.key), delivery.payload)
            elif delivery.kind == "question":
                self._answer(delivery)
            else:
                self._presence(delivery)
        except MessageRejected as error:
            self.drop(error, delivery.key)

    def drop(self, error: MessageRejected, where: str) -> None:
        """Counts something that was not let in."""
        self._ledger.drops[error.reason] += 1
        if self._ledger.drops.total() <= MAX_DROP_EVENTS:  # a flood fills neither log nor record
            peer = keys.node_of(where) if where.count("/") >= 4 else where
            about = {"tick": self._flight.tick, "peer": peer, "reason": error.reason}
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
        self._ledger.nodes_lost += self.flying
        self.dismiss(member, f"lost: {why}")
        if len(member.uavs) and self.flying:
            self._flight.lose(member.uavs, "lost", f"{member.name}: {why}")
        else:
            self._note("lost", f"{member.name}: {why}")

    def dismiss(self, member: Member, why: str) -> None:
        """Sends a node home; its UAVs are free for another."""
        self.members.lose(member)
        self._stop(member.name, why)
        if self._barrier.forget(member.name) and member.role == LEADER:
            self.on_leader_lost()

    def expire(self, patience_s: float) -> None:
        """Loses who was admitted during the flight and never became ready: nobody else could have its UAVs."""
        for member in self.members.present:
            if not member.ready and self._clock() - member.since_s > patience_s:
                self.lose(member, f"not ready after {patience_s:.0f} s")

    # -- messages -----------------------------------------------------------------------------------------------

    def _hear(self, name: str, raw: bytes) -> None:
        member = self.members.get(name)
        if member is None:
            raise MessageRejected("unknown-node", name)
        if member.lost:
            self._stop(name, "lost: nobody waits for this node any more")
            raise MessageRejected("unknown-node", f"{name}, which was lost")
        try:
            if len(raw) > (most := inbound.limit(member.rows, self._scenario)):
                raise MessageRejected("oversized", f"{len(raw)} bytes, at most {most} expected")
            if raw[1:2] in TYPES:
                self._barrier.take(member, raw)
            else:
                self._control(member, codec.decode(raw))
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
            self._note(member.role, f"{member.name}: {escaped(message.text)}")
        elif isinstance(message, Refusal):
            self.unfit.append(escaped(message.reason))
            self.lose(member, escaped(message.reason))
        else:
            raise MessageRejected("wrong-kind", f"{type(message).__name__} from a node")

    def _welcome(self, member: Member) -> None:
        if self.closed:  # it was not there yet when all others were sent home
            self._stop(member.name, "finished")
            return
        if member.ready:
            return
        member.ready = True
        if self.flying and member.role == LEADER:
            self._note("rejoined", f"{member.name} stands by")
        elif self.flying:
            self._flight.rejoin(member.uavs, member.name)

    # -- questions ----------------------------------------------------------------------------------------------

    def _answer(self, delivery: Delivery) -> None:
        assert delivery.reply is not None
        join = codec.decode(delivery.payload, limit=256)
        if not isinstance(join, Join):
            raise MessageRejected("wrong-kind", f"{type(join).__name__} as a question")
        if keys.node_of(delivery.key) != (asker := keys.asker(join.role, join.uav)):
            raise MessageRejected("wrong-name", f"a Join of {asker}")
        if self.closed:
            delivery.reply(codec.encode(Refusal("the flight is over")))
            return
        name, uavs = STATION, np.zeros(0, dtype=np.intp)  # a ground station only asks what is flown
        if join.role != STATION:
            try:
                member = self.members.admit(join, self._clock())
            except JoinRefused as error:
                delivery.reply(codec.encode(Refusal(str(error), error.for_now)))
                return
            name, uavs = member.name, member.uavs
            about = {"tick": self._flight.tick, "peer": name, "uavs": uavs.tolist()}
            log.info("%s joined with UAVs %s", name, uavs.tolist(), extra=about)
        past = self.resumed if not self.flying and len(uavs) else None
        delivery.reply(
            codec.encode(
                Welcome(
                    run=self._fingerprint,
                    node=name,
                    uavs=tuple(uavs.tolist()),
                    tick=self._flight.tick,
                    scenario=scenario.encode(self._scenario),
                    initial_states=self._plan,
                    memory=b"" if past is None else past.memory(uavs),
                    plugins=self._plugins,
                )
            )
        )

    # -- liveliness ---------------------------------------------------------------------------------------------

    def _presence(self, delivery: Delivery) -> None:
        role, name = delivery.key.split("/")[-2:]
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
            self._stop(name, "lost: nobody waits for this node any more")

    def _stop(self, name: str, why: str) -> None:
        self._bus.put(keys.sense(self._run, name), codec.encode(Stop(self._fingerprint, why)))


def escaped(text: str) -> str:
    """A text of somebody else's as one line of a log, and not a long one."""
    return text[:MAX_TEXT].encode("unicode_escape").decode("ascii")
