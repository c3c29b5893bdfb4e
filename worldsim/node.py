"""The world node: the clock of the run. It asks everyone, waits for the answers, moves the world, reports."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from meanflock.channel.medium import NO_LINKS, Medium
from meanflock.federation.post import Post
from meanflock.swarm import state
from meanflock.swarm.errors import RunFailed
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Act, Frames
from meanflock.worldsim import inbox
from meanflock.worldsim.admission import Admission
from meanflock.worldsim.awake import Awake
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.checkpoint import EVERY_TICKS, Checkpoints, Resumption
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.durations import Durations
from meanflock.worldsim.faults import Script
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.inbound import Replies
from meanflock.worldsim.leading import Leading
from meanflock.worldsim.members import LEADER, Member, Members
from meanflock.worldsim.merger import FrameMerger
from meanflock.worldsim.pace import Pace
from meanflock.worldsim.reporter import Reporter
from meanflock.worldsim.schedule import Schedule
from meanflock.worldsim.summary import protocol_summary, summary
from meanflock.worldsim.waiting import Waiting

REPORT_EVERY_TICKS = 10


class World:
    """One run, from the first node that joins to the summary.

    Its public parts may be looked at while it flies, from any thread, and nothing in them changed. listeners: ground
    stations that are there. waits: at the barrier, from the last question of a tick to the last answer. ticks: how long
    they took in all.
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
        rows_at_most: int | None = None,
        refused: Counter[str] | None = None,
        resume: Resumption | None = None,
        checkpoint_every: int = EVERY_TICKS,
        block_rows: int = 50,
        telemetry: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`barrier_s`: how long a tick waits for a node before the node is lost. `realtime`: ticks follow the wall
        clock, this many times faster. `stations`: how many recording listeners must be there before the first tick.
        `rows_at_most`: UAVs one agent may hold. `refused`: what the router kept out, by reason. `mode` goes into the
        summary. `resume`: where to go on, instead of at tick 0. `checkpoint_every`: ticks, a multiple of ten; 0 for
        never. `block_rows`: of a block of telemetry at most, as long as ticks do not follow the wall clock.
        `telemetry`: false where nobody will ever listen. `clock`: seconds, monotonic.

        Raises:
            BadInput: what is to be resumed is of another scenario, or incomplete.
        """
        self._scenario, self._declared, self._clock = scenario, scenario.declared, clock
        self._bus, self.run, self.mode, self._stations, self._barrier_s = bus, run, mode, stations, barrier_s
        self._schedule = None if realtime is None else Schedule(realtime, scenario.dt)
        self._checkpoint_every, self._resumed = checkpoint_every, resume
        self.post, self._script = Post(scenario), Script(scenario)
        self.flight, self.air = Flight(scenario), Medium(scenario)
        counters, self.ticks = Counters(refused), Durations()
        commands = Commands(scenario.uavs, len(self._declared.diagnostics))
        rows, self.counters, self._commands = block_rows if realtime is None else None, counters, commands
        self._reporter = Reporter(
            bus, run, self.flight, self.air, commands, counters, self.post, block_rows=rows, keeps=telemetry
        )
        self._note, self.outbox = self._reporter.note, self._reporter.outbox
        self._awake = Awake(self._script, self.flight, self._reporter)
        self._leading = Leading(self.post, self._note)
        self._begin()
        self._connect(rows_at_most)

    def _begin(self) -> None:
        """At tick 0, or where a run that is resumed goes on."""
        self._checkpoints = Checkpoints(self.flight, self.air, self.counters, self._commands, self.post, self._reporter)
        if self._resumed is not None:
            self._checkpoints.restore(self._resumed)
        else:
            self.air.meter.initial(state.SIZE * self._scenario.radio.bits_per_float)  # the mission plan

    def _connect(self, rows_at_most: int | None) -> None:
        """Whoever the world talks to: who may take part, the barrier of a tick, and what is waited for."""
        scenario, bus, run, note, counters = self._scenario, self._bus, self.run, self._note, self.counters
        federated = self._declared.is_federated
        wanted = scenario.leaders(self.flight.tick) if federated else 0
        members = self.members = Members(scenario.uavs, wanted, standbys=federated, rows_at_most=rows_at_most)
        replies = Replies(scenario, keys.fingerprint(run), self.post)
        barrier = self._barrier = Barrier(bus, run, replies, self._clock)
        admission = self._admission = Admission(
            bus, run, members, self.flight, barrier, self.outbox, counters, note, self._clock
        )
        self.handle = admission.handle  # one delivery; never raises for what the network sent
        self.stop = admission.stop  # sends every node home
        self.listeners = admission.listeners
        admission.resumed, admission.stations = self._resumed, self._stations
        admission.on_leader_lost = self._ask_leader
        self._merger = FrameMerger(self.post, admission.drop)
        patience_s = self._barrier_s
        pace = Pace(scenario.pace, note, patience_s)
        self._waiting = Waiting(barrier, admission, counters, self._schedule, patience_s, pace, self._wait, self._clock)
        self.waits = self._waiting.took

    def gather(self, timeout_s: float, cancelled: Callable[[], bool] = lambda: False) -> None:
        """Waits until every UAV has its agent, and the rounds their leader; `cancelled` is asked now and then.

        Raises:
            RunFailed: not in time; the message says who is missing.
        """
        end = self._clock() + timeout_s
        while not self._admission.complete:
            self._admission.check(timeout_s if self._clock() > end else None, cancelled())
            self._admission.expire(timeout_s / 2)  # who died before it was ready leaves time for another
            self._wait(0.1)
        nodes = f"{len(self.members.present)} nodes hold {self._scenario.uavs} UAVs"
        again = "" if self._resumed is None else f" and go on from tick {self.flight.tick}"
        self._note("resumed" if again else "joined", nodes + again)

    def fly(self, cancelled: Callable[[], bool] = lambda: False) -> Iterator[int]:
        """The flight; yields the number of every tick flown, so that the caller can stop in between. `cancelled` is
        asked while it stands still because every agent is lost; RunFailed is raised where none comes back.
        """
        self._started = self._clock()
        self._admission.flying = True
        self._leading.begin(self.members)
        if self._resumed is None:
            self._reporter.add(NO_LINKS)
        while self._has_agents(cancelled) and not self.flight.over:
            began = self._clock()
            if self._schedule is not None:
                self._schedule.begin(began)
            self._tick()
            self.ticks.add(self._clock() - began)
            yield self.flight.tick

    def finish(self, linger_s: Callable[[], float] = lambda: 10.0) -> dict[str, Any]:
        """Ends the run: everyone is told, the last block is handed over, the summary made.

        `linger_s`: for how long a recorder may take nothing before the world leaves; asked again and again.
        """
        record = summary(self.flight, self.air.meter, self.run, self.mode, self.wall_s())
        names, dropped = self._declared.diagnostics, self.outbox.dropped
        record |= protocol_summary(self.counters, self.post, self._commands, names, self._schedule, dropped)
        self._note("finished", f"{record['arrived']} of {self._scenario.uavs} arrived")
        finished = self._reporter.finish(record)
        self._leave("finished", linger_s)
        if self.outbox.waiting:
            self._reporter.repeat(finished)
        return record

    def _has_agents(self, cancelled: Callable[[], bool]) -> bool:
        try:
            return self._waiting.for_an_agent(cancelled)
        except RunFailed as error:
            self._note("failed", str(error))
            self._reporter.flush()
            self._leave(str(error), linger_s=lambda: 5.0)
            raise

    def _leave(self, why: str, linger_s: Callable[[], float]) -> None:
        """Everyone is told; what is left of the telemetry is handed over, as long as some of it is every `linger_s`."""
        self._admission.closed = True
        self.stop(why)
        since = self._clock()
        # What is on its way when a session closes may never arrive, so all of it is waited for, the summary too.
        back = self._stations > 0 and self.flight.over  # a recorder that was killed may be on its way back
        while (self.listeners or back) and (waiting := self.outbox.waiting) and self._clock() - since < linger_s():
            self._reporter.publish()
            self._wait(0.1)
            since = self._clock() if self.outbox.waiting < waiting else since

    def _tick(self) -> None:
        tick = self.flight.tick
        # 1. What must be kept is kept, who never came is given up, what the script says goes wrong.
        self._checkpoints.keep(self.wall_s)
        self._admission.expire(self._barrier_s)
        self._awake.begin(tick, self.members, self._admission, self._note)
        # 2. Ask: every node gets its own states and what its radios received.
        reporting = tick % REPORT_EVERY_TICKS == 0
        whole = reporting and self._checkpoint_every > 0 and tick % self._checkpoint_every == 0
        self._ask(tick, reporting, whole)
        # 3. Wait for everyone, or lose who does not answer.
        self._waiting.for_answers()
        # 4. What they want to say goes on the air.
        frames = self._collect()
        links = self.air.send(tick, frames, self.flight.states, self._script.cut(tick, self.flight.states))
        self.post.close(tick, frames, links, self._awake.uavs, self._has_leader, self._note)
        # 5. The world moves.
        self.flight.advance(self._commands.accelerations, self._script.gust(tick, self.flight.states))
        # 6. Whoever listens is told.
        if reporting:
            self._report(tick, whole)
        self._reporter.add(links)
        self._reporter.publish()

    def _ask(self, tick: int, reporting: bool, whole: bool) -> None:
        due = self.post.deliver(tick, self.air.due(tick), self._awake.uavs)
        self._barrier.open(tick, reporting)
        self._ask_leader()  # first: in a round it has the most to do, and all others wait for it
        asked = [member for member in self.members.present if member.role != LEADER and member.ready]
        if not self._awake.everyone and not self._awake.uavs.all():
            asked = [member for member in asked if self._awake.uavs[member.uavs].any()]
        received = inbox.of_agents(due, self._awake.uavs)
        for member in asked:
            own = inbox.of_agent(member, received, self._scenario.uavs) if received else ()
            if self.post.has_mail:
                own += self.post.mail("agent", member.name, member.uavs)
            self._barrier.ask(member, self.flight.states[member.place], own, whole)

    def _ask_leader(self) -> None:
        self._leading.ask(self.flight.tick, self.members, self._barrier, self._awake.uavs)

    def _has_leader(self) -> bool:
        return self.members.lead() is not None

    def _wait(self, timeout_s: float) -> None:
        if (delivery := self._bus.receive(timeout_s)) is not None:
            self.handle(delivery)

    def _collect(self) -> list[Frames]:
        """Commands and diagnostics into their rows; frames of one kind joined, sources ascending."""
        barrier = self._barrier
        barrier.close()
        disbelieved: set[int] = set()
        for name, member in barrier.asked.items():
            if (act := barrier.acts.get(name)) is not None and (len(act.refused) or len(act.lost) or act.memory):
                disbelieved |= self._regard(member, act)
        if disbelieved:
            self._disbelieve(disbelieved)
        insane = self._commands.store(barrier.commands, barrier.replied, self._awake.uavs, self.flight.on_way)
        if len(insane):
            self.flight.lose(insane, "diverged", "an answer beyond all bounds")
        frames = self._merger.merged(self.flight.tick, barrier.sent, self._awake.uavs, self.air.meter)
        if (idle := self.flight.idle) is not None:
            self._commands.accelerations[idle] = 0.0
        return frames

    def _regard(self, member: Member, act: Act) -> set[int]:
        """What a node says of its own UAVs, and what the aggregation remembers; returns the UAVs whose states it
        refuses."""
        if len(act.lost):
            self.flight.lose(act.lost.astype(np.intp), "diverged", "the controller failed or left the finite numbers")
        if member.role == LEADER and act.memory:
            self.post.rule_record = act.memory
        if len(uploads := ~act.refused[act.refused < 0]):
            self.counters.uploads_refused += len(uploads)
            self._note("refused", f"uploads of UAV {', '.join(map(str, uploads))} were not averaged")
        return set(act.refused[act.refused >= 0].tolist())

    def _disbelieve(self, uavs: set[int]) -> None:
        """Their states count once a tick, however many nodes refuse them; they are named once a run."""
        self.counters.states_refused += len(uavs)
        if new := sorted(uavs - self.counters.disbelieved):
            self.counters.disbelieved |= uavs
            self._note("refused", f"states of UAV {', '.join(map(str, new))} were not believed: no UAV can be so")

    def _report(self, tick: int, whole: bool) -> None:
        asked, acts = self._barrier.asked, self._barrier.acts
        self._reporter.learned(tick, asked, acts, self._awake.uavs & ~self.flight.lost)
        # What ends the whole run may take one by one: no checkpoint is taken so soon after a loss.
        settled = self._admission.settled(self._barrier_s)
        if whole and settled and self._awake.uavs[~self.flight.lost].all():
            self._checkpoints.collect(self._barrier, self._admission.drop)

    def wall_s(self) -> float:
        """Flown so far, from the first tick on."""
        return self.counters.wall_s + self._clock() - self._started

    @property
    def diagnostics(self) -> np.ndarray:
        """What the controllers reported of the last tick, `(N, K)`, as in `Telemetry`."""
        return self._commands.diagnostics
