"""Admission: nodes join, leave and rejoin a run here; every delivery of the world's bus is handled or rejected here."""

import logging
import math
from collections.abc import Callable

import numpy as np

from meanflock.federation.plan import plugins_of
from meanflock.net import keys
from meanflock.net.access import OBSERVER, STATION
from meanflock.net.barrier import Barrier
from meanflock.net.bus import Bus, Delivery
from meanflock.net.limits import JOIN_BYTES, RECEIVED_BYTES, Limits
from meanflock.net.members import LEADER, JoinRefused, Member, Members
from meanflock.net.outbox import Outbox
from meanflock.net.tick import TYPES
from meanflock.swarm import mission, scenario
from meanflock.swarm.errors import BadInput, MessageRejected, RunFailed, printable
from meanflock.swarm.events import FlightEvent, LastReturn, LeaderStandsBy, Lost, NodeLost, Rejoined
from meanflock.swarm.events.nodes import FailedAverage, FailedController, FailedTraining, FoundDraw, Problem
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import (
    DREW,
    UNAVERAGED,
    UNTRAINED,
    Acknowledgement,
    Event,
    Join,
    Message,
    Ready,
    Refusal,
    Stop,
    Welcome,
)
from meanflock.worldsim.checkpoint import Resumption
from meanflock.worldsim.counters import MAX_DROP_EVENTS
from meanflock.worldsim.failures import Reports
from meanflock.worldsim.world import World

log = logging.getLogger("meanflock.world")

MAX_EVENTS = 100  # events of a node, and one more for each of its UAVs
_REASONS_OF_REPEATS = ("duplicate", "stale")  # second reply to a repeated request, in its tick or after


class Admission:
    """Handles every delivery of the world's bus: replies, questions to join, presence of nodes and stations.

    Attributes:
        members: the nodes.
        listeners: names of the ground stations that listen.
        flying: true from the first tick on; a node lost before is merely missing.
        closed: true after the last tick; a node that leaves then is not lost.
        reports: what nodes report of failures; the owner replaces it.
        unfit: reasons of admitted nodes that cannot take part.
        unattended: UAVs whose agent was lost and that have no other yet, and since when, on the world's clock.
    """

    def __init__(
        self,
        bus: Bus,
        run: str,
        world: World,
        members: Members,
        barrier: Barrier,
        news: list[FlightEvent],
        clock: Callable[[], float],
        *,
        limits: Limits,
        outbox: Outbox | None,
        stations: int,
        resumed: Resumption | None,
    ) -> None:
        """
        Args:
            bus: carries the messages. run: name of the run.
            world: whose nodes join; read, never changed, but for its counters.
            members, barrier: the nodes, and the requests of the current tick.
            news: what became of the nodes is appended.
            clock: seconds, monotonic.
            limits: the longest messages.
            outbox: what stations acknowledge; None: no station ever listens.
            stations: ground stations that must listen before the first tick.
            resumed: the checkpoint whose memories agents get when they join before the first tick.
        """
        scenario = world.scenario
        self.members = members
        self.listeners: set[str] = set()
        self.flying = False
        self.closed = False
        self.reports = Reports()
        self.unfit: list[str] = []
        self.unattended: dict[int, float] = {}
        self._bus = bus
        self._run = run
        self._fingerprint = keys.fingerprint(run)
        self._received = keys.received(run)
        self._scenario = scenario
        self._known = world.plan.node_scenario
        self._starts = mission.starts(scenario).astype(control.FLOAT_OF_BITS[scenario.radio.bits_per_float])
        self._plugins = plugins_of(scenario)
        self._world = world
        self._barrier = barrier
        self._outbox = outbox
        self._counters = world.counters
        self._news = news
        self._clock = clock
        self._limits = limits
        self._stations = stations
        self._federated = world.plan.declared.is_federated
        self._leader_lost = False  # in flight
        self._resumed = resumed
        bus.subscribe(keys.act(run, "*"), barrier.offer)
        bus.subscribe(self._received)
        bus.watch(keys.alive(run, "*", "*"))
        bus.answer(keys.join(run))

    def handle(self, delivery: Delivery) -> None:
        """Handle one delivery. Never raises because of what the network sent."""
        try:
            if delivery.kind == "message" and delivery.key == self._received:
                received = control.decode_as(Acknowledgement, delivery.payload, self._fingerprint, limit=RECEIVED_BYTES)
                if self._outbox is not None:
                    self._outbox.acknowledge(received.block)
            elif delivery.kind == "message":
                self._receive(keys.node_of(delivery.key), delivery.payload)
            elif delivery.kind == "question":
                self._answer(delivery)
            elif delivery.kind == "oversized":
                if delivery.key != self._received:
                    keys.node_of(delivery.key)  # rejects it as wrong-key if it is not the key of a node
                raise MessageRejected("oversized", f"{delivery.size} bytes, at most {delivery.largest} expected")
            else:
                self._presence(delivery)
        except MessageRejected as error:
            self.drop(error, delivery.key)

    def drop(self, error: MessageRejected, where: str) -> None:
        """Count a message that is rejected, and log the first ones."""
        if dropped := self._counters.drop(error, where, self._world.tick, _peer(where)):
            self._news.append(dropped)

    def lose(self, member: Member, reason: str) -> None:
        """Mark a node as lost and send it Stop."""
        if self.closed:
            self.members.lose(member)  # it left because it got Stop
        if member.lost:
            return
        about = {"tick": self._world.tick, "peer": member.name, "uavs": member.uavs.tolist(), "reason": reason}
        log.warning("lost %s: %s", member.name, reason, extra=about)
        self._counters.nodes_lost += self.flying
        self._leader_lost |= self.flying and member.role == LEADER
        self.dismiss(member, reason, lost=True)
        if len(member.uavs) and self.flying:
            self.unattended |= dict.fromkeys(member.uavs.tolist(), self._clock())
            self._news.append(Lost(self._world.tick, tuple(member.uavs.tolist()), f"{member.name}: {reason}"))
        else:
            self._news.append(NodeLost(self._world.tick, member.name, reason))

    def expel(self, name: str, reason: str, out_s: float) -> None:
        """Lose a node, and let no other node take its place for so many seconds."""
        member = self.members.get(name)
        assert member is not None
        self.lose(member, reason)
        if out_s:
            self.members.close_places(member, self._clock() + out_s, f"is lost: {reason}")

    def dismiss(self, member: Member, reason: str, lost: bool = False) -> None:
        """Stop a node and free its UAVs for another. `lost`: whether the node should join again."""
        self.members.lose(member)
        self._stop(member.name, reason, lost)
        self._barrier.forget(member.name)

    def expire(self, patience_s: float) -> None:
        """Lose nodes that were admitted but not ready in time: until then no other node can have their UAVs."""
        for member in self.members.present:
            if not member.ready and self._clock() - member.since_s > patience_s:
                self.lose(member, f"not ready after {patience_s:.0f} s")

    def settled(self, for_s: float) -> bool:
        """Returns whether every agent without a successor was lost at least so many seconds ago."""
        return self._clock() - max(self.unattended.values(), default=-math.inf) >= for_s

    @property
    def complete(self) -> bool:
        """Returns whether all agents, leaders and ground stations are there."""
        return self.members.complete and len(self.listeners) >= self._stations

    @property
    def missing(self) -> str:
        """The nodes that are not there yet, in words."""
        absent = self._stations - len(self.listeners)
        return ", ".join(filter(None, [self.members.missing(), f"{absent} ground station" if absent > 0 else ""]))

    def stop(self, reason: str) -> None:
        """Send every node Stop."""
        for member in self.members.present:
            self._stop(member.name, reason)

    def check(self, late_s: float | None, cancelled: bool) -> None:
        """Stop all nodes if the swarm cannot become complete. `late_s`: the timeout, if it is over.

        Raises:
            BadInput: a node cannot take part.
            RunFailed: timeout or interrupt; the message names the missing nodes.
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

    def _receive(self, name: str, raw: bytes) -> None:
        member = self.members.get(name)
        if member is None:
            raise MessageRejected("unknown-node", name)
        if member.lost:
            self._stop(name, "the world counts this node as lost", lost=True)
            raise MessageRejected("unknown-node", f"{name}, which was lost")
        try:
            if raw[1:2] in TYPES:
                self._barrier.take(member, raw)
            else:
                self._control(member, control.decode(raw, limit=self._limits.act(member.rows)))
        except MessageRejected as error:
            if error.reason not in _REASONS_OF_REPEATS or not self._barrier.is_repeat(name):
                raise

    def _control(self, member: Member, message: Message) -> None:
        """Handle a message of a node that is not a reply."""
        if getattr(message, "run", self._fingerprint) != self._fingerprint:
            raise MessageRejected("wrong-run", f"run {message.run:#x}, this is {self._fingerprint:#x}")  # type: ignore[union-attr]
        if isinstance(message, Ready):
            self._welcome(member)
        elif isinstance(message, Event):
            problem = _problem_of(member, message)
            member.events += 1
            is_one_more = member.events <= MAX_EVENTS + member.rows  # world and ground station keep all events
            self.reports.add(member.name, member.uavs, problem, has_event=is_one_more)
            if not is_one_more:
                raise MessageRejected("oversized", f"event {member.events} of a node, which may tell no more")
        elif isinstance(message, Refusal):
            self._refused(member, printable(message.reason))
        else:
            raise MessageRejected("wrong-kind", f"{type(message).__name__} from a node")

    def _refused(self, member: Member, reason: str) -> None:
        """Lose a node that was admitted but cannot take part. In flight its UAVs are lost already, so an event says
        why they still have no agent."""
        few = len(self.unfit) < MAX_DROP_EVENTS
        is_out = self.flying and self.unattended.keys() >= set(member.uavs.tolist())
        if few:
            self.unfit.append(reason)
        self.lose(member, reason)
        if few and member.rows and is_out:
            self._news.append(NodeLost(self._world.tick, member.name, reason))

    def _welcome(self, member: Member) -> None:
        if self.closed:  # it joined after the others were stopped
            self._stop(member.name, "finished")
            return
        if member.ready:
            return
        member.ready = True
        for uav in member.uavs.tolist():
            self.unattended.pop(uav, None)
        has_predecessor = member.role != LEADER or self._federated or self._leader_lost
        if not self.flying or not has_predecessor:  # a flight without rounds does not wait for its first leader
            return
        self._counters.nodes_rejoined += 1
        if member.role == LEADER:
            self._news.append(LeaderStandsBy(self._world.tick, member.name))
        else:
            self._news.append(Rejoined(self._world.tick, tuple(member.uavs.tolist()), member.name))
        if self.members.rejoined(member, self._world.tick, self._scenario.pace):
            last = LastReturn(self._world.tick, member.name)
            log.warning(last.text, extra={"tick": self._world.tick, "peer": member.name})
            self._news.append(last)

    # -- questions ----------------------------------------------------------------------------------------------

    def _answer(self, delivery: Delivery) -> None:
        assert delivery.reply is not None
        join = control.decode(delivery.payload, limit=JOIN_BYTES)
        if not isinstance(join, Join):
            raise MessageRejected("wrong-kind", f"{type(join).__name__} as a question")
        if keys.node_of(delivery.key) != (expected := keys.requested_name(join.role, join.uav)):
            raise MessageRejected("wrong-name", f"a Join of {expected}")
        listens = join.role in (STATION, OBSERVER)
        if self.closed and not listens:  # a station may still get the telemetry that waits
            delivery.reply(control.encode(Refusal("the flight is over", over=True)))
            return
        name = join.role
        uavs = np.zeros(0, dtype=np.intp)
        if join.role == STATION:
            self._rewind()
        elif not listens:
            try:
                member = self.members.admit(join, self._clock())
            except JoinRefused as error:
                delivery.reply(control.encode(Refusal(str(error), error.for_now, error.over)))
                return
            name, uavs = member.name, member.uavs
            about = {"tick": self._world.tick, "peer": name, "uavs": uavs.tolist()}
            log.info("%s joined with UAVs %s", name, uavs.tolist(), extra=about)
        past = self._resumed if not self.flying and len(uavs) else None
        delivery.reply(
            control.encode(
                Welcome(
                    run=self._fingerprint,
                    node=name,
                    uavs=tuple(uavs.tolist()),
                    tick=self._world.tick,
                    scenario=scenario.encode(self._scenario if listens else self._known),
                    initial_states=self._starts,
                    memory=b"" if past is None else past.memory(self._world.plan.groups, uavs),
                    plugins=self._plugins,
                    stations=len(self._scenario.stations),
                )
            )
        )

    # -- liveliness ---------------------------------------------------------------------------------------------

    def _presence(self, delivery: Delivery) -> None:
        role, name = keys.presence_of(delivery.key)
        if role == STATION:
            if delivery.kind == "alive":
                self.listeners.add(name)
                self._rewind()
            else:
                self.listeners.discard(name)
            return
        member = self.members.get(name)
        if member is None:
            return
        if delivery.kind == "gone":
            self.lose(member, "its liveliness token vanished")
        elif member.lost:
            self._stop(name, "the world counts this node as lost", lost=True)

    def _rewind(self) -> None:
        if self._outbox is not None:
            self._outbox.rewind()

    def _stop(self, name: str, reason: str, lost: bool = False) -> None:
        reason = f"lost: {reason}" if lost else reason
        self._bus.put(keys.sense(self._run, name), control.encode(Stop(self._fingerprint, reason, lost)))


def _problem_of(member: Member, message: Event) -> Problem:
    """The failure that a node reports.

    Raises:
        MessageRejected: it reports a failure at a UAV that it does not fly, or a training of several.
    """
    if message.kind == DREW:
        return FoundDraw()
    text, uavs = printable(message.text), message.uavs
    if member.role == LEADER or not (uavs or message.kind in (UNTRAINED, UNAVERAGED)):
        return text
    named = set(uavs)
    if not 0 < len(named) == len(uavs) or not named <= set(member.uavs.tolist()):
        raise MessageRejected("wrong-shape", f"a failure at UAVs {list(uavs)}; expected its own")
    if message.kind == UNAVERAGED:
        return FailedAverage(uavs, text)
    if message.kind != UNTRAINED:
        return FailedController(uavs, text)
    if len(uavs) > 1:
        raise MessageRejected("wrong-shape", f"a training of UAVs {list(uavs)}; expected one of its own")
    return FailedTraining(uavs[0], text)


def _peer(where: str) -> str:
    """Name of the node that a key belongs to; the text itself if it is not the key of a node."""
    try:
        return keys.node_of(where)
    except MessageRejected:
        return printable(where)
