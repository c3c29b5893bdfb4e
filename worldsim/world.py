"""The world node: the clock of a run. A tick asks all nodes, waits for their replies, moves the UAVs and reports."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from meanflock.channel.medium import NO_LINKS, Medium
from meanflock.federation.account import ModelsHash
from meanflock.federation.post import Post
from meanflock.swarm import state
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Act, Frames
from meanflock.worldsim.admission import Admission
from meanflock.worldsim.barrier import Barrier, Commands, FrameMerger, Replies, reaching, received_by
from meanflock.worldsim.checkpoint import EVERY_TICKS, Checkpoints, Resumption
from meanflock.worldsim.faults import Script
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.limits import Limits
from meanflock.worldsim.members import LEADER, Member, Members
from meanflock.worldsim.reporting import Reporter
from meanflock.worldsim.steering import LOCKSTEP, Port, Steering
from meanflock.worldsim.summary import Counters, Durations, Schedule, protocol_summary, summary
from meanflock.worldsim.waiting import Pace, Waiting

REPORT_EVERY_TICKS = 10

_NO_STATES = np.zeros((0, state.SIZE))  # the request of a leader has none


class World:
    """One run, from the first node that joins to the summary.

    Other threads may read the attributes at any time, and must not change them.

    Attributes:
        run: name of the run.
        mode: how the nodes run; a field of the summary.
        flight: states, energies and metrics of the UAVs.
        air: the radio.
        post: the rounds.
        models: the hash of the models that were shared.
        counters: counters of the protocol.
        members: the nodes.
        listeners: names of the ground stations that listen.
        outbox: telemetry that no ground station has acknowledged.
        waits: durations of the barrier, from the last request of a tick to the last reply.
        ticks: durations of whole ticks.
    """

    def __init__(
        self,
        scenario: Scenario,
        bus: Bus,
        run: str,
        *,
        mode: str = "processes",
        stations: int = 0,
        barrier_s: float = 10.0,
        realtime: float | None = None,
        steer: Port | None = None,
        rows_at_most: int | None = None,
        refused: Counter[str] | None = None,
        resume: Resumption | None = None,
        limits: Limits | None = None,
        checkpoint_every: int = EVERY_TICKS,
        block_rows: int = 50,
        telemetry: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """
        Args:
            scenario: what is flown.
            bus: carries the messages.
            run: name of the run.
            mode: how the nodes run.
            stations: ground stations that must listen before the first tick.
            barrier_s: how long a tick waits for a node before the node is lost.
            realtime: how many times faster than the wall clock ticks go; None: as fast as they can.
            steer: where clients command UAVs in place of their controllers; only in real time.
            rows_at_most: most UAVs that an agent may hold; None: any number.
            refused: messages that the bus dropped, by reason.
            resume: the checkpoint to continue from; None: start at tick 0.
            limits: the longest messages, if the caller has them already.
            checkpoint_every: ticks, a multiple of ten; 0 for no checkpoints.
            block_rows: most rows of a block of telemetry, unless ticks follow the wall clock.
            telemetry: false if no station will ever listen.
            clock: seconds, monotonic.

        Raises:
            BadInput: the checkpoint belongs to another scenario, or is incomplete; or lockstep would be steered.
        """
        if steer is not None and realtime is None:
            raise BadInput(LOCKSTEP)
        self.run = run
        self.mode = mode
        self._scenario = scenario
        self._declared = scenario.declared
        self._bus = bus
        self._clock = clock
        self._stations = stations
        self._barrier_s = barrier_s
        self._resumed = resume
        self._checkpoint_every = checkpoint_every
        self._schedule = None if realtime is None else Schedule(realtime, scenario.dt)
        self.ticks = Durations()

        # What flies, and what is counted and reported.
        self.flight = Flight(scenario)
        self.air = Medium(scenario)
        self.post = Post(scenario)
        self.models = ModelsHash(scenario)
        self.counters = Counters(refused)
        self._commands = Commands(scenario.uavs, len(self._declared.diagnostics))
        self._script = Script(scenario)
        self._reporter = Reporter(
            bus,
            run,
            self.flight,
            self.air,
            self._commands,
            self.counters,
            self.post,
            block_rows=block_rows if realtime is None else None,
            enabled=telemetry,
        )
        self._note = self._reporter.note
        self.outbox = self._reporter.outbox
        self._checkpoints = Checkpoints(
            self.flight, self.air, self.counters, self._commands, self.post, self.models, self._reporter
        )
        if resume is not None:
            self._checkpoints.restore(resume)
        else:
            self.air.meter.initial(state.SIZE * scenario.radio.bits_per_float)  # the mission plan

        # The nodes.
        federated = self._declared.is_federated
        leaders = scenario.leaders(self.flight.tick) if federated else 0
        limits = limits or Limits(scenario)
        leaderless = federated and not any(hop.role == LEADER for hop in scenario.hops)
        self.members = Members(
            scenario.uavs, leaders, standbys=federated, leaderless=leaderless, rows_at_most=rows_at_most
        )
        self._barrier = Barrier(bus, run, Replies(scenario, keys.fingerprint(run), self.post, limits.act), clock)
        self._admission = Admission(
            bus,
            run,
            self.members,
            self.flight,
            self._barrier,
            self.outbox,
            self.counters,
            self._note,
            clock,
            limits=limits,
            stations=stations,
            resumed=resume,
            on_leader_lost=self._ask_leader,
            on_leader_failed=self.post.fail,
        )
        self.handle = self._admission.handle
        self.stop = self._admission.stop
        self.listeners = self._admission.listeners
        self._steering = (
            None if steer is None else Steering(steer, self.counters, self._note, self._admission.drop, clock)
        )
        self._merger = FrameMerger(self.post, self._admission.drop)
        self._waiting = Waiting(
            self._barrier,
            self._admission,
            self.counters,
            self._schedule,
            barrier_s,
            Pace(scenario.pace, self._note, barrier_s),
            self._wait,
            clock,
        )
        self.waits = self._waiting.took
        self._all = np.ones(scenario.uavs, dtype=bool)
        self._awake = self._all  # (N,), UAVs that take part in the tick: neither lost nor paused
        self._leading: str | None = None  # the leader that was asked last
        self._informed: str | None = None  # the leader that has the state of the aggregation rule
        self._reporting = False  # whether nodes report their models in this tick
        self._checkpoint_due = False  # whether they report their memory

    def gather(self, timeout_s: float, cancelled: Callable[[], bool] = lambda: False) -> None:
        """Wait until every UAV has its agent, and the rounds their leader; `cancelled` is asked ten times a second.

        Raises:
            RunFailed: nodes are missing after the timeout; the message names them.
        """
        end = self._clock() + timeout_s
        while not self._admission.complete:
            self._admission.check(timeout_s if self._clock() > end else None, cancelled())
            self._admission.expire(timeout_s / 2)  # leaves as much time for a node in the place of one that died
            self._wait(0.1)
        nodes = f"{len(self.members.present)} nodes hold {self._scenario.uavs} UAVs"
        if self._resumed is None:
            self._note("joined", nodes)
        else:
            self._note("resumed", f"{nodes} and continue from tick {self.flight.tick}")

    def fly(self, cancelled: Callable[[], bool] = lambda: False) -> Iterator[int]:
        """Fly; yields the number of each tick, so that the caller can stop after any.

        `cancelled` is asked while the flight waits because all agents are lost.

        Raises:
            RunFailed: all agents are lost, and none came back.
        """
        self.take_off()
        while self.has_next(cancelled):
            begin = self._clock()
            if self._schedule is not None:
                self._schedule.begin(begin)
            self.ask()
            self.move()
            self.ticks.add(self._clock() - begin)
            yield self.flight.tick
        self.flight.books.settle()

    def take_off(self) -> None:
        """Begin the flight: the members are complete."""
        self._started = self._clock()
        self._admission.flying = True
        self._leading = leader.name if (leader := self.members.lead()) is not None else None
        if self._steering is not None:
            self._steering.begin()
        if self._resumed is None:
            self._reporter.add(NO_LINKS)

    def has_next(self, cancelled: Callable[[], bool] = lambda: False) -> bool:
        """Whether another tick is flown; waits while all agents are lost.

        Raises:
            RunFailed: all agents are lost, and none came back.
        """
        try:
            has_agents = self._waiting.for_an_agent(cancelled)
        except RunFailed as error:
            self._note("failed", str(error))
            self._reporter.flush()
            self._leave(str(error), linger_s=lambda: 5.0)
            raise
        return has_agents and not self.flight.over

    def finish(self, linger_s: Callable[[], float] = lambda: 10.0) -> dict[str, Any]:
        """End the run: make the summary, stop all nodes, hand over the telemetry.

        `linger_s`: how long the world waits for a station that acknowledges nothing; asked again and again.
        """
        record = summary(self.flight, self.air.meter, self.run, self.mode, self.wall_s())
        record |= protocol_summary(
            self.counters,
            self.post,
            self._commands,
            self._declared.diagnostics,
            self._schedule,
            self.outbox.dropped,
            can_be_steered=self._steering is not None,
        )
        record["models_sha256"] = self.models.hexdigest
        self._note("finished", f"{record['arrived']} of {self._scenario.uavs} arrived")
        finished = self._reporter.finish(record)
        self._leave("finished", linger_s)
        if self.outbox.waiting:
            self._reporter.repeat(finished)
        return record

    def wall_s(self) -> float:
        """Wall-clock time since the first tick, in s; of a resumed run, with the time flown before."""
        return self.counters.wall_s + self._clock() - self._started

    @property
    def diagnostics(self) -> np.ndarray:
        """(N, K), diagnostics of the last tick, as in `Telemetry`."""
        return self._commands.diagnostics

    def _leave(self, reason: str, linger_s: Callable[[], float]) -> None:
        """Stop all nodes; wait until the telemetry is acknowledged, or nothing was for `linger_s`."""
        self._admission.closed = True
        self.stop(reason)
        since = self._clock()
        # A message under way when the session closes can be lost, so the world waits for all acknowledgements, that of
        # the summary included. A station that was killed may be on its way back.
        expected = self._stations > 0 and self.flight.over
        while (self.listeners or expected) and (waiting := self.outbox.waiting) and self._clock() - since < linger_s():
            self._reporter.publish()
            self._wait(0.1)
            since = self._clock() if self.outbox.waiting < waiting else since

    def _wait(self, timeout_s: float) -> None:
        if (delivery := self._bus.receive(timeout_s)) is not None:
            self.handle(delivery)

    # -- a tick -------------------------------------------------------------------------------------------------

    def ask(self) -> None:
        """The first half of a tick: faults begin, and each node gets the states of its UAVs and its frames."""
        tick = self.flight.tick
        # 1. Begin: send the checkpoint of the last tick, give up nodes that never became ready, begin faults.
        self._checkpoints.keep(self.wall_s)
        self._admission.expire(self._barrier_s)
        self._begin_faults(tick)
        # 2. Ask: each node gets the states of its UAVs and the frames that reached it.
        self._reporting = tick % REPORT_EVERY_TICKS == 0
        self._checkpoint_due = self._reporting and self._checkpoint_every > 0 and tick % self._checkpoint_every == 0
        self._ask(tick)

    def move(self) -> None:
        """The second half of a tick: wait for the replies, transmit their frames, move the UAVs and report."""
        tick = self.flight.tick
        # 3. Wait for all replies.
        self._waiting.for_answers()
        # 4. Transmit the frames of the replies.
        frames = self._collect()
        self.models.add(frames)
        on_air = self.post.transmitted(frames, self._awake)
        links = self.air.send(tick, on_air, self.flight.states, self._script.cut(tick, self.flight.states))
        self.post.close(tick, frames, on_air, links, self._awake, self._has_leader, self._note)
        # 5. Move.
        if self._steering is not None:
            self._commands.steered = self._steering.replaced(self._commands.accelerations, self.flight.idle)
        self.flight.advance(self._commands.flown, self._script.gust(tick, self.flight.states))
        # 6. Report.
        if self._reporting:
            self._report(tick)
        self._reporter.add(links)
        self._reporter.publish()
        if self._steering is not None:
            self._steering.tell(self.flight.tick, self.flight.states, self.flight.status)

    def _begin_faults(self, tick: int) -> None:
        """Kill and pause UAVs as the fault script says; sets the UAVs that are awake."""
        if not self._scenario.faults:
            self._awake = ~self.flight.lost if self.flight.any_lost else self._all
            return
        reason = "killed by the fault script"
        self._reporter.events += self._script.events(tick)
        killed = self._script.killed(tick)
        self.flight.lose(killed, "lost", reason)
        lost = self.flight.lost
        for member in self.members.present if len(killed) else ():
            if np.isin(member.uavs, killed).any() and lost[member.uavs].all():
                self._admission.dismiss(member, reason)
        for _ in range(self._script.leaders_lost(tick)):
            if (leader := self.members.lead()) is not None:
                self._admission.dismiss(leader, reason)
                self._note("lost", f"{leader.name}: {reason}")
        self._awake = ~lost & ~self._script.paused(tick)

    def _ask(self, tick: int) -> None:
        due = self.post.deliver(tick, self.air.due(tick), self._awake)
        self._barrier.open(tick, self._reporting)
        self._ask_leader()  # first: in a round it has the most to do, and all others wait for it
        asked = [member for member in self.members.present if member.role != LEADER and member.ready]
        if self._awake is not self._all and not self._awake.all():
            asked = [member for member in asked if self._awake[member.uavs].any()]
        arrived = reaching(due, self._awake)
        for member in asked:
            received = received_by(member, arrived, self._scenario.uavs) if arrived else ()
            received += self.post.mail("agent", member.name, member.uavs)
            self._barrier.ask(member, self.flight.states[member.place], received, self._checkpoint_due)

    def _ask_leader(self) -> None:
        """Ask the elected leader if a round needs it; again if the leader is lost and another one is elected."""
        if not self._barrier.standing or not self.post.leader_is_due(self.flight.tick, self._awake):
            return
        leader = self.members.lead()
        if leader is None:
            return
        if self._leading not in (None, leader.name):
            self._note("leader", f"{leader.name} takes over from {self._leading}")
        memory = self.post.rule_record if leader.name != self._informed else b""
        self._leading = self._informed = leader.name
        self._barrier.ask(leader, _NO_STATES, self.post.mail("leader", leader.name), memory=memory)

    def _has_leader(self) -> bool:
        return self.members.lead() is not None

    def _collect(self) -> list[Frames]:
        """Store the commands and diagnostics of the replies; returns their frames, joined by kind."""
        barrier = self._barrier
        barrier.close()
        implausible: set[int] = set()
        for name, member in barrier.asked.items():
            if (act := barrier.acts.get(name)) is not None and (len(act.refused) or len(act.lost) or act.memory):
                implausible |= self._take_notice(member, act)
        if implausible:
            self._count_implausible(implausible)
        diverged = self._commands.store(barrier.commands, barrier.replied, self._awake, self.flight.on_way)
        if len(diverged):
            self.flight.lose(diverged, "diverged", "an answer beyond all bounds")
        frames = self._merger.merged(self.flight.tick, barrier.sent, self._awake, self.air.meter)
        if (idle := self.flight.idle) is not None:
            self._commands.accelerations[idle] = 0.0
        return frames

    def _take_notice(self, member: Member, act: Act) -> set[int]:
        """Take the lost UAVs, the rule's state and the refused uploads of a reply; returns the UAVs whose states it
        refuses."""
        if len(act.lost):
            self.flight.lose(act.lost.astype(np.intp), "diverged", "the controller failed or left the finite numbers")
        if member.role == LEADER and act.memory:
            self.post.rule_record = act.memory
        if len(uploads := ~act.refused[act.refused < 0]):
            self.counters.uploads_refused += len(uploads)
            self.post.refuse(uploads.tolist())
            self._note("refused", f"uploads of UAV {', '.join(map(str, uploads))} were not averaged", uploads.tolist())
        return set(act.refused[act.refused >= 0].tolist())

    def _count_implausible(self, uavs: set[int]) -> None:
        """Count each UAV once a tick, however many nodes refuse its states; name it once a run."""
        self.counters.states_refused += len(uavs)
        if new := sorted(uavs - self.counters.implausible):
            self.counters.implausible |= uavs
            self._note("refused", f"states of UAV {', '.join(map(str, new))} were not believed: no UAV can be so")

    def _report(self, tick: int) -> None:
        self._reporter.learned(tick, self._barrier.asked, self._barrier.acts, self._awake & ~self.flight.lost)
        # No checkpoint right after a loss: if the whole run is ending, its nodes may be lost one by one.
        settled = self._admission.settled(self._barrier_s)
        if self._checkpoint_due and settled and self._awake[~self.flight.lost].all():
            self._checkpoints.collect(self._barrier, self._admission.drop)
