"""Crew of nodes on a bus: requests to agents and leader, and the wait for their replies."""

import logging
import time
from collections.abc import Callable

import numpy as np

from meanflock.agent.learning.worker import FIT_S
from meanflock.federation.mailbox import mail_for
from meanflock.net import keys
from meanflock.net.admission import Admission
from meanflock.net.barrier import Barrier, Replies
from meanflock.net.bus import Bus, Delivery
from meanflock.net.limits import Limits
from meanflock.net.members import LEADER, Member, Members
from meanflock.net.outbox import Outbox
from meanflock.net.pace import DelayRules
from meanflock.swarm.errors import MessageRejected, RunFailed
from meanflock.swarm.events import FlightEvent, FlightResumed, LeaderTookOver, NodeLost, NodesJoined
from meanflock.swarm.state import Mask
from meanflock.swarm.wire.control import decode_record
from meanflock.swarm.wire.messages import Act
from meanflock.worldsim.checkpoint import Memories, Resumption
from meanflock.worldsim.clocks import Durations, TickSchedule
from meanflock.worldsim.crew import ReportedModels, goals_of, inbox_of
from meanflock.worldsim.failures import Reports
from meanflock.worldsim.tick import Acts, Senses
from meanflock.worldsim.world import KILLED, World

log = logging.getLogger("meanflock.world")

STALL_S = 0.5  # longest step of the wait that counts: in a longer one this machine stood still, perhaps the nodes too
ASK_AGAIN_S = 1.0  # a request without a reply is repeated: the first one after a declaration can get lost
SLOW_BYTES_S = 10e6  # of a long reply of many UAVs, which is computed, sent and read meanwhile


class RemoteCrew:
    """Agents and leaders on a bus, from the first that joins to the last that leaves.

    Other threads may read the attributes at any time, and must not change them.

    Attributes:
        members: the nodes.
        waits: durations from the last request of a tick to its last reply, or to the end of the wait.
    """

    def __init__(
        self,
        world: World,
        bus: Bus,
        run: str,
        resume: Resumption | None = None,
        *,
        limits: Limits,
        outbox: Outbox | None = None,
        stations: int = 0,
        barrier_s: float = 10.0,
        schedule: TickSchedule | None = None,
        rows_at_most: int | None = None,
        cancelled: Callable[[], bool] = lambda: False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """
        Args:
            world: whose UAVs the nodes fly; read, never changed, but for its counters.
            bus: carries the messages.
            run: name of the run.
            resume: the checkpoint that the world continues from; None: none.
            limits: the longest messages.
            outbox: telemetry that stations acknowledge; None: no station ever listens.
            stations: ground stations that must listen before the first tick.
            barrier_s: how long a tick waits for a node before the node is lost.
            schedule: of a flight in real time; None in lockstep.
            rows_at_most: most UAVs that an agent may hold; None: any number.
            cancelled: whether nobody waits for the flight any more; asked while all agents are missing.
            clock: seconds, monotonic.
        """
        plan, scenario = world.plan, world.scenario
        federated = plan.declared.is_federated
        leaders = plan.leaders(world.tick) if federated else 0
        leaderless = federated and not any(hop.role == LEADER for hop in plan.hops)
        self.members = Members(
            scenario.uavs,
            leaders,
            standbys=federated,
            leaderless=leaderless,
            rows_at_most=rows_at_most,
            groups=[group.uavs for group in plan.groups],
        )
        self.waits = Durations()
        self._world = world
        self._reported = ReportedModels(world.plan)
        self._bus = bus
        self._outbox = outbox
        self._stations = stations
        self._barrier_s = barrier_s
        self._schedule = schedule
        self._cancelled = cancelled
        self._limits = limits
        self._clock = clock
        self._is_resumed = resume is not None
        self._news: list[FlightEvent] = []
        self._no_states = np.zeros((0, world.scenario.state_numbers))  # the request of a leader has none
        self._barrier = Barrier(bus, run, Replies(plan, keys.fingerprint(run), world.ledger, limits.act), clock)
        self._admission = Admission(
            bus,
            run,
            world,
            self.members,
            self._barrier,
            self._news,
            clock,
            limits=limits,
            outbox=outbox,
            stations=stations,
            resumed=resume,
        )
        self._pace = DelayRules(scenario.pace, self._news, barrier_s)
        self._leading: str | None = None  # the last leader
        self._has_one_leader = not plan.is_resumable  # no other leader can go on with its rule

    @property
    def listeners(self) -> set[str]:
        """Names of the ground stations that listen."""
        return self._admission.listeners

    def handle(self, delivery: Delivery) -> None:
        """Handle one delivery of the bus. Never raises because of what the network sent."""
        self._admission.handle(delivery)

    def gather(self, timeout_s: float) -> None:
        """Wait until every UAV has its agent, and the rounds their leader.

        Raises:
            BadInput: a node cannot take part.
            RunFailed: nodes are missing after the timeout, or the wait was cancelled; the message names them.
        """
        end = self._clock() + timeout_s
        while not self._admission.complete:
            self._admission.check(timeout_s if self._clock() > end else None, self._cancelled())
            self._admission.expire(timeout_s / 2)  # leaves as much time for a node in the place of one that died
            self._receive(0.1)
        resumed_at = self._world.tick if self._is_resumed else None
        begun = NodesJoined if resumed_at is None else FlightResumed
        self._news.append(begun(self._world.tick, len(self.members.present), self._world.scenario.uavs))
        self._admission.flying = True
        self._leading = leader.name if (leader := self.members.lead()) is not None else None

    def answer(self, senses: Senses) -> tuple[Acts, Mask]:
        """See `Crew.answer`.

        Raises:
            RunFailed: all agents are lost, and none came back.
        """
        if self._schedule is not None:
            self._schedule.begin(self._clock())
        self._admission.expire(self._barrier_s)
        self._kill(senses)
        self._ask(senses)
        begin = self._clock()
        end = self._in_lockstep(senses) if self._schedule is None else self._until(senses, self._schedule.end)
        self.waits.add(end - begin)
        self._barrier.close()
        acts, absent = self._collect(senses)
        self._await_an_agent()
        acts.news, acts.reports = self.last_news()
        return acts, absent

    def last_news(self) -> tuple[list[FlightEvent], Reports]:
        """The events of nodes since the last answer, and the failures that nodes report."""
        news, self._news[:] = list(self._news), []
        reports, self._admission.reports = self._admission.reports, Reports()
        return news, reports

    def leave(self, reason: str, linger_s: Callable[[], float] = lambda: 10.0) -> None:
        """Stop all nodes; wait until the telemetry is acknowledged, or nothing was for `linger_s`."""
        self._admission.closed = True
        self.stop(reason)
        outbox, since = self._outbox, self._clock()
        # A message under way when the session closes can be lost, so the world waits for all acknowledgements, that of
        # the summary included. A station that was killed may be on its way back.
        expected = self._stations > 0 and self._world.over
        while outbox is not None and (self.listeners or expected) and (waiting := outbox.waiting):
            if self._clock() - since >= linger_s():
                return
            outbox.publish()
            self._receive(0.1)
            since = self._clock() if outbox.waiting < waiting else since

    def stop(self, reason: str) -> None:
        """Send every node Stop."""
        self._admission.stop(reason)

    def _receive(self, timeout_s: float) -> None:
        if (delivery := self._bus.receive(timeout_s)) is not None:
            self.handle(delivery)

    # -- requests -----------------------------------------------------------------------------------------------

    def _kill(self, senses: Senses) -> None:
        """Dismiss the nodes that the fault script kills in this tick."""
        for member in self.members.present if len(senses.killed) else ():
            if np.isin(member.uavs, senses.killed).any() and senses.lost[member.uavs].all():
                self._admission.dismiss(member, KILLED)
        for _ in range(senses.leaders_killed):
            if (leader := self.members.lead()) is not None:
                self._admission.dismiss(leader, KILLED)
                self._news.append(NodeLost(senses.tick, leader.name, KILLED))
                self._note_takeover(senses.tick)

    def _note_takeover(self, tick: int) -> None:
        """Note the leader if it is another one than before."""
        if (leader := self.members.lead()) is not None and leader.name != self._leading:
            if self._leading is not None:
                self._news.append(LeaderTookOver(tick, leader.name, self._leading))
            self._leading = leader.name

    def _ask(self, senses: Senses) -> None:
        """Send each node what its UAVs are told."""
        self._barrier.open(senses.tick, senses.report)
        self._ask_leader(senses)  # first: in a round it has the most to do, and all others wait for it
        asked = [member for member in self.members.present if member.role != LEADER and member.ready]
        if not senses.awake.all():
            asked = [member for member in asked if senses.awake[member.uavs].any()]
        for member in asked:
            inbox = inbox_of(senses, member.uavs, member.read)
            member.read = senses.newest
            self._barrier.ask(
                member, senses.states[member.place], inbox, senses.checkpoint, goals_of(senses, member.uavs)
            )

    def _ask_leader(self, senses: Senses) -> None:
        """Ask the elected leader if a round needs it, and it was not asked yet; the next one if it is lost at once."""
        while senses.leads and (leader := self.members.lead()) is not None and leader.name not in self._barrier.asked:
            self._note_takeover(senses.tick)
            record = b"" if leader.informed else senses.rule_record
            mail = mail_for(senses.letters, "leader", after=leader.read)
            leader.informed, leader.read = True, senses.newest
            self._barrier.ask(leader, self._no_states, mail, memory=record)

    # -- replies ------------------------------------------------------------------------------------------------

    def _in_lockstep(self, senses: Senses) -> float:
        """Wait until every node has replied or is lost; returns the time then."""
        now = self._clock()
        waited = 0.0  # by the nodes that are asked now
        waited_before = 0.0  # by nodes that are lost since
        repeated = 0.0  # value of `waited` when the requests were last repeated
        unhurried = self._unhurried()
        reply_s = (
            self._limits.act(max((member.rows for member in self._barrier.asked.values()), default=0)) / SLOW_BYTES_S
        )
        end_s = self._barrier_s + reply_s
        self._pace.begin(senses.tick, unhurried)
        self._ask_leader(senses)  # another one, where the one that was asked is lost
        while self._barrier.silent:
            before = now
            self._receive(0.1)
            now = self._clock()
            waited += min(now - before, STALL_S)
            self._ask_leader(senses)
            self._pace.look(waited, self._barrier)
            missing = self._barrier.missing if waited > end_s else []
            patience_s = {name: end_s + (FIT_S if name in unhurried else 0.0) for name in missing}
            if overdue := [name for name in missing if waited > patience_s[name]]:
                for name in overdue:
                    self._admission.lose(self._barrier.asked[name], f"no answer for {patience_s[name]:.0f} s")
                self._ask_leader(senses)
                waited_before += waited
                waited = repeated = 0.0  # a leader that takes over has as much time
            elif waited - repeated > ASK_AGAIN_S + reply_s:
                repeated = waited
                self._barrier.ask_again()
        self._pace.charge(waited_before + waited, now, self._barrier)
        for verdict in self._pace.overdrawn():
            self._admission.expel(verdict.node, verdict.reason, verdict.out_s)
        return now

    def _unhurried(self) -> set[str]:
        """Names of the nodes that are asked and may take as long as a training: agents with a UAV that trains, and a
        leader that no other can replace, as that of a ServerApp."""
        busy = self._world.commands.busy
        if not (busy.any() or self._has_one_leader):
            return set()
        return {
            name
            for name, member in self._barrier.asked.items()
            if (self._has_one_leader if member.role == LEADER else busy[member.uavs].any())
        }

    def _until(self, senses: Senses, end: float) -> float:
        """Wait in real time until `end`; returns the time of the last reply, or `end` if replies are missing."""
        complete: float | None = None
        for _ in range(len(self._barrier.asked)):  # takes replies that are here already, even if the tick began late
            self._receive(0.0)
        while (left := end - (now := self._clock())) > 0:
            if complete is None and not self._barrier.silent:
                complete = now
            self._receive(left)
            self._ask_leader(senses)
        self._world.counters.late(sum(len(self._barrier.asked[name].uavs) for name in self._barrier.missing))
        return now if complete is None else complete

    def _await_an_agent(self) -> None:
        """Wait, after a tick, while all agents are lost; not if the wait is cancelled.

        Raises:
            RunFailed: no agent came back in time.
        """
        if not self._admission.unattended:
            return
        end = self._clock() + self._barrier_s
        while not any(member.role != LEADER and member.ready for member in self.members.present):
            if self._cancelled():
                return
            if self._clock() > end:
                raise RunFailed(f"every agent is lost, and none came back within {self._barrier_s:.0f} s")
            self._receive(0.1)
            self._admission.expire(self._barrier_s)

    def _collect(self, senses: Senses) -> tuple[Acts, Mask]:
        """Join the replies."""
        barrier, admission = self._barrier, self._admission
        acts = Acts(barrier.commands, barrier.sent, has_leader=self.members.lead() is not None)
        found = [(member, reply) for name, member in barrier.asked.items() if (reply := barrier.acts.get(name))]
        for member, reply in found:
            acts.add(reply)
            if member.role == LEADER and reply.memory:
                acts.rule_record = reply.memory
        if senses.report:
            acts.models = self._reported.joined((member.place, reply.models) for member, reply in found)
        if senses.checkpoint and admission.settled(self._barrier_s):  # if the run is ending, nodes go one by one
            acts.memories = self._memories(found)
        return acts, ~barrier.replied

    def _memories(self, found: list[tuple[Member, Act]]) -> Memories:
        memories = Memories(self._world.plan.groups)
        for member, reply in found:
            if member.rows and reply.memory:
                try:
                    memories.take(member.uavs, decode_record(reply.memory))
                except MessageRejected as error:
                    self._admission.drop(error, f"the memory of {member.name}")
        return memories
