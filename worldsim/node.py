"""The world node: the clock of the run. It asks everyone, waits for the answers, moves the world, tells the story."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np

from meanflock.channel.medium import NO_LINKS, Medium
from meanflock.swarm import __version__, state
from meanflock.swarm.errors import BadInput, MessageRejected, RunFailed
from meanflock.swarm.model import BEYOND_SENSE
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus
from meanflock.swarm.rounds import Rounds
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, Event, Finished, FrameKind, Frames, Stop
from meanflock.worldsim import checkpoint, inbox
from meanflock.worldsim.admission import Admission
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.checkpoint import Memories, Resumption
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.durations import Durations
from meanflock.worldsim.faults import Script
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.heads import Heads
from meanflock.worldsim.inbound import Replies
from meanflock.worldsim.instruments import Instruments
from meanflock.worldsim.members import LEADER, Member, Members
from meanflock.worldsim.merger import FrameMerger
from meanflock.worldsim.pace import Pace
from meanflock.worldsim.schedule import Schedule
from meanflock.worldsim.summary import summary, weight_spread
from meanflock.worldsim.telemetry import Outbox, Rows
from meanflock.worldsim.waiting import Waiting

REPORT_EVERY_TICKS = 10
_BLOCK_ROWS, _BLOCK_STATES = 20, 2500  # of a block of telemetry: so many rows, or more of a small swarm

Clock = Callable[[], float]


class World:
    """One run, from the first node that joins to the summary."""

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
        checkpoint_every: int = checkpoint.EVERY_TICKS,
        block_rows: int = 50,
        telemetry: bool = True,
        clock: Clock = time.monotonic,
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
        self._scenario = scenario
        self._bus, self._run, self._fingerprint = bus, run, keys.fingerprint(run)
        self._mode, self._barrier_s, self._clock = mode, barrier_s, clock
        self._schedule = None if realtime is None else Schedule(realtime, scenario.dt)
        self._stations, self._checkpoint_every = stations, checkpoint_every
        self._declared = scenario.declared
        self._rounds = Rounds(scenario)
        self._rounds.draw_ahead()
        self._script = Script(scenario)
        self.flight = Flight(scenario)
        self.air = Medium(scenario)
        rows = max(_BLOCK_ROWS, min(block_rows, _BLOCK_STATES // scenario.uavs)) if realtime is None else 2
        self._rows = Rows(self._fingerprint, scenario.uavs, rows, self._declared)
        self._outbox = Outbox(keeps=telemetry)
        self._counters = Counters(refused)
        self._ticks = Durations()
        self._uploads = inbox.Uploads(FrameKind.RELAY if scenario.federation.clusters > 1 else FrameKind.UPLOAD)
        self._heads = Heads(scenario)
        self._barrier = Barrier(bus, run, Replies(scenario, self._fingerprint))
        self._commands = Commands(scenario.uavs, len(self._declared.diagnostics))
        self._all = np.ones(scenario.uavs, dtype=bool)
        self._awake = self._all  # who is neither lost nor asleep; as a rule that very array
        self._memories: Memories | None = None  # where, in the last tick, all were asked for what they remember
        self._aggregation = b""  # what the aggregation rule remembers, a record
        self._leads: str | None = None
        self._informed: str | None = None  # the leader that knows what the aggregation remembers
        self._resumed = resume
        if resume is None:
            self.air.meter.initial(state.SIZE * scenario.radio.bits_per_float)  # the mission plan
        else:
            self._restore(resume)
        federated = self._declared.is_federated
        wanted = scenario.leaders(self.flight.tick) if federated else 0
        self._members = Members(scenario.uavs, wanted, standbys=federated, rows_at_most=rows_at_most)
        members, barrier, counters = self._members, self._barrier, self._counters
        self._admission = Admission(
            scenario, bus, run, members, self.flight, barrier, self._outbox, counters, self._note, clock
        )
        self._merger = FrameMerger(self._rounds, counters, self._admission.drop, self._note)
        self._admission.resumed = resume
        self._admission.on_leader_lost = self._ask_leader
        pace = Pace(scenario.pace, self._note)
        self._waiting = Waiting(barrier, self._admission, counters, self._schedule, barrier_s, pace, self._wait, clock)
        self.handle = self._admission.handle  # one delivery; never raises for what the network sent

    # -- the run ------------------------------------------------------------------------------------------------

    def gather(self, timeout_s: float, cancelled: Callable[[], bool] = lambda: False) -> None:
        """Waits until every UAV has its agent, and the rounds their leader; `cancelled` is asked now and then.

        Raises:
            RunFailed: not in time; the message says who is missing.
        """
        end = self._clock() + timeout_s
        while not self._members.complete or len(self._admission.listeners) < self._stations:
            if self._admission.unfit:
                self.stop("a node cannot take part")
                raise BadInput(self._admission.unfit[0])
            if cancelled():
                self.stop("interrupted")
                raise RunFailed(f"interrupted while waiting for {self._missing()}")
            if self._clock() > end:
                self.stop("the swarm is not complete")
                raise RunFailed(f"after {timeout_s:.0f} s the swarm still waits for {self._missing()}")
            self._wait(0.1)
        nodes = f"{len(self._members.present)} nodes hold {self._scenario.uavs} UAVs"
        again = "" if self._resumed is None else f" and go on from tick {self.flight.tick}"
        self._note("resumed" if again else "joined", nodes + again)

    def fly(self, cancelled: Callable[[], bool] = lambda: False) -> Iterator[int]:
        """The flight; yields the number of every tick flown, so that the caller can stop in between. `cancelled` is
        asked while it stands still because every agent is lost; RunFailed is raised where none comes back.
        """
        self._started = self._clock()
        self._admission.flying = True
        self._leads = leader.name if (leader := self._members.lead()) is not None else None
        if self._resumed is None:
            self._rows.add(self.flight, self.air, self._commands, NO_LINKS, self._counters)
        while self._has_agents(cancelled) and not self.flight.over:
            began = self._clock()
            if self._schedule is not None:
                self._schedule.begin(began)
            self._tick()
            self._ticks.add(self._clock() - began)
            yield self.flight.tick

    def finish(self, linger_s: float = 10.0) -> dict[str, Any]:
        """Ends the run: everyone is told, the last block is handed over, the summary made."""
        record = summary(self.flight, self.air.meter, self._run, self._mode, self._wall_s(), self._protocol())
        self._note("finished", f"{record['arrived']} of {self._scenario.uavs} arrived")
        self._outbox.add(self._rows.take())
        self._outbox.add(finished := Finished(self._fingerprint, self._rows.block, msgspec.json.encode(record)))
        self._leave("finished", linger_s)
        if not self._outbox.empty:
            self._put(keys.telemetry(self._run), finished)
        return record

    def _has_agents(self, cancelled: Callable[[], bool]) -> bool:
        try:
            return self._waiting.for_an_agent(cancelled)
        except RunFailed as error:
            self._note("failed", str(error))
            self._outbox.add(self._rows.take())
            self._leave(str(error), linger_s=5.0)
            raise

    def _leave(self, why: str, linger_s: float) -> None:
        """Everyone is told; what is left of the telemetry is handed over."""
        self._admission.closed = True
        self.stop(why)
        end = self._clock() + linger_s
        # What is on its way when a session closes may never arrive, so all of it is waited for, the summary too.
        back = self._stations > 0 and self.flight.over  # a recorder that was killed may be on its way back
        while (self._admission.listeners or back) and not self._outbox.empty and self._clock() < end:
            self._publish()
            self._wait(0.1)

    def stop(self, reason: str) -> None:
        """Sends every node home."""
        for member in self._members.present:
            self._put(keys.sense(self._run, member.name), Stop(self._fingerprint, reason))

    def _missing(self) -> str:
        absent = self._stations - len(self._admission.listeners)
        return ", ".join(filter(None, [self._members.missing(), f"{absent} ground station" if absent > 0 else ""]))

    def _tick(self) -> None:
        tick = self.flight.tick
        # 1. What must be kept is kept, who never came is given up, what the script says goes wrong.
        self._keep()
        self._admission.expire(self._barrier_s)
        self._play(tick)
        # 2. Ask: every node gets its own states and what its radios received.
        reporting = tick % REPORT_EVERY_TICKS == 0
        whole = reporting and self._checkpoint_every > 0 and tick % self._checkpoint_every == 0
        self._ask(tick, reporting, whole)
        # 3. Wait for everyone, or lose who does not answer.
        self._waiting.for_answers()
        # 4. What they want to say goes on the air.
        frames = self._collect()
        links = self.air.send(tick, frames, self.flight.states, self._script.cut(tick, self.flight.states))
        if number := self._rounds.relays(tick):
            for text in self._heads.relayed(number, frames, links):
                self._note("void", text)
        # 5. The world moves.
        self.flight.advance(self._commands.accelerations, self._script.gust(tick, self.flight.states))
        # 6. Whoever listens is told.
        if reporting:
            self._report(tick, whole)
        if self._rows.full:
            self._outbox.add(self._rows.take())
        self._rows.add(self.flight, self.air, self._commands, links, self._counters)
        self._publish()

    # -- step 1 -------------------------------------------------------------------------------------------------

    def _play(self, tick: int) -> None:
        """The fault script, as far as it takes somebody out of the mission or puts them to sleep."""
        if not self._scenario.faults:
            self._awake = ~self.flight.lost if self.flight.any_lost else self._all
            return
        for event in self._script.events(tick):
            self._rows.note(event)
        killed = self._script.killed(tick)
        self.flight.lose(killed, "lost", "killed by the fault script")
        lost = self.flight.lost
        for member in self._members.present if len(killed) else ():
            if np.isin(member.uavs, killed).any() and lost[member.uavs].all():
                self._admission.dismiss(member, "killed by the fault script")
        for _ in range(self._script.leaders_lost(tick)):
            if (leader := self._members.lead()) is not None:
                self._admission.dismiss(leader, "killed by the fault script")
                self._note("lost", f"{leader.name}: killed by the fault script")
        self._awake = ~lost & ~self._script.paused(tick)

    # -- step 2 -------------------------------------------------------------------------------------------------

    def _ask(self, tick: int, reporting: bool, whole: bool) -> None:
        due = self.air.due(tick)
        self._uploads.receive(due)
        self._heads.receive(due, self._awake)
        self._barrier.open(tick, reporting)
        self._ask_leader()  # first: in a round it has the most to do, and all others wait for it
        asked = [member for member in self._members.present if member.role != LEADER and member.ready]
        if self._awake is not self._all and not self._awake.all():
            asked = [member for member in asked if self._awake[member.uavs].any()]
        heard = inbox.of_agents(due, self._awake)
        for member in asked:
            own = inbox.of_agent(member, heard, self._scenario.uavs) + self._heads.read(member)
            self._barrier.ask(member, self.flight.states[member.place], own, whole)

    def _ask_leader(self) -> None:
        """Asks the elected leader, if a round is open; again if another is elected before the tick is over."""
        tick = self.flight.tick
        if not self._barrier.standing or not self._rounds.is_open(tick):
            return
        leader = self._members.lead()
        if leader is None:
            if number := self._rounds.closes(tick):
                self._note("void", f"round {number} is void: there is no leader")
            return
        if self._leads not in (None, leader.name):
            self._note("leader", f"{leader.name} takes over from {self._leads}")
        memory = self._aggregation if leader.name != self._informed else b""
        self._leads = self._informed = leader.name
        self._barrier.ask(leader, np.zeros((0, state.SIZE)), self._uploads.read(leader.name), memory=memory)

    # -- step 3 -------------------------------------------------------------------------------------------------

    def _wait(self, timeout_s: float) -> None:
        delivery = self._bus.receive(timeout_s)
        if delivery is not None:
            self.handle(delivery)

    # -- step 4 -------------------------------------------------------------------------------------------------

    def _collect(self) -> list[Frames]:
        """Commands and diagnostics into their rows; frames of one kind joined, sources ascending."""
        self._barrier.close()
        asked, acts = self._barrier.asked, self._barrier.acts
        disbelieved: set[int] = set()
        for name, member in asked.items():
            if (act := acts.get(name)) is not None and (len(act.refused) or len(act.lost) or act.memory):
                disbelieved |= self._regard(member, act)
        if disbelieved:
            self._disbelieve(disbelieved)
        awake = None if self._awake is self._all else self._awake
        numbers = {name: act.commands for name, act in acts.items() if len(act.commands)}
        if len(insane := self._commands.store(asked, numbers, awake)):
            self.flight.lose(insane, "diverged", "an answer beyond all bounds")
        frames = self._merger.of(self.flight.tick, self._barrier.spoken, self._awake, self.air.meter)
        if number := self._rounds.closes(self.flight.tick):
            self._uploads.close(number)
        if self.flight.any_lost:
            self._commands.accelerations[self.flight.lost] = 0.0
        return frames

    def _regard(self, member: Member, act: Act) -> set[int]:
        """Notes what is wrong with others' models or with a node's own UAVs; keeps what the aggregation remembers.

        Returns the UAVs whose states are not believed there.
        """
        if len(act.lost):
            self.flight.lose(act.lost.astype(np.intp), "diverged", "the controller failed or left the finite numbers")
        if member.role == LEADER and act.memory:
            self._aggregation = act.memory
        if not len(act.refused):
            return set()
        if member.role != LEADER and not self._rounds.relays(act.tick):
            return set(act.refused.tolist())
        self._counters.uploads_refused += len(act.refused)
        self._note("refused", f"uploads of UAV {', '.join(map(str, act.refused))} were not averaged")
        return set()

    def _disbelieve(self, uavs: set[int]) -> None:
        """Counts, once a tick however many nodes say so, UAVs whose states are not believed; names each once."""
        self._counters.states_refused += len(uavs)
        if new := sorted(uavs - self._counters.disbelieved):
            self._counters.disbelieved |= uavs
            self._note("refused", f"states of UAV {', '.join(map(str, new))} were not believed: no UAV can be so")

    # -- step 6 -------------------------------------------------------------------------------------------------

    def _report(self, tick: int, whole: bool) -> None:
        asked, acts = self._barrier.asked, self._barrier.acts
        alive = self._awake & ~self.flight.lost
        if self._declared.weights:
            models = np.full((self._scenario.uavs, self._declared.weights), np.nan)
            for name, act in acts.items():
                if act.models is not None:
                    models[asked[name].place] = act.models
            sane = (np.abs(models) < BEYOND_SENSE).all(axis=-1)  # NaN is below nothing
            if (counted := sane & alive).any():
                leader = self._scenario.federation.leader
                self._counters.spread = weight_spread(models if counted.all() else models[counted])
                self._rows.report(tick, np.where(sane[leader], models[leader], 0.0), self._counters.spread)
        settled = not self._admission.unattended.any_since(
            self._barrier_s
        )  # what ends the whole run may take one by one
        if whole and settled and self._awake[~self.flight.lost].all():
            self._memories = self._remembered()

    def _remembered(self) -> Memories | None:
        """What everyone who is not lost replied to a request for it; None where somebody did not."""
        memories = Memories(self._scenario.uavs)
        for name, act in self._barrier.acts.items():
            member = self._barrier.asked[name]
            if member.rows and act.memory:
                try:
                    memories.take(member, control.decode_record(act.memory))
                except MessageRejected as error:
                    self._admission.drop(error, f"the memory of {name}")
        return memories if memories.complete(~self.flight.lost) else None

    def _keep(self) -> None:
        """A checkpoint, if everyone said what it remembers in the last tick; it goes out with all rows before it."""
        memories, self._memories = self._memories, None
        if memories is None or self._outbox.holds_checkpoint:
            return
        body = checkpoint.encode(
            {
                "scenario": self._scenario.sha256(),
                "plugins": [list(plugin) for plugin in self._scenario.plugins()],
                "version": __version__,
                "block": self._rows.block,
                "flight": self.flight.snapshot(),
                "air": self.air.snapshot(),
                "counters": self._counters.snapshot(self._wall_s()),
                "uploads": self._uploads.snapshot(),
                "heads": self._heads.snapshot(),
                "commands": self._commands.accelerations,
                "largest": self._commands.largest,
                "memory": memories.snapshot(),
                "aggregation": self._aggregation,
            }
        )
        if len(body) <= checkpoint.MAX_BYTES:
            self._outbox.add(self._rows.take(body))

    def _restore(self, resume: Resumption) -> None:
        kept = resume.checkpoint
        if kept.get("scenario") != self._scenario.sha256():
            raise BadInput("the checkpoint is of another scenario; resume a run with its own scenario.toml")
        for was, now in zip(kept.get("plugins", ()), self._scenario.plugins(), strict=False):
            if tuple(was) != now:
                raise BadInput(f"the checkpoint is of {was[0]} {was[1]!r} of {was[2]}; here it is of {now[2]}")
        try:
            self.flight.restore(kept["flight"], resume.history)
            self.air.restore(kept["air"])
            self._counters.restore(kept["counters"])
            self._uploads.restore(kept["uploads"])
            self._heads.restore(kept["heads"])
            self._commands.accelerations[...] = kept["commands"]
            self._commands.largest[...] = kept["largest"]
            self._aggregation = kept["aggregation"]
            self._rows.resume(kept["block"] + 1, self.flight.tick + 1)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise BadInput(f"the run cannot be resumed: {error}") from error

    # -- what goes out ------------------------------------------------------------------------------------------

    def _publish(self) -> None:
        for raw in self._outbox.next():
            self._bus.put(keys.telemetry(self._run), raw)

    def _note(self, kind: str, text: str) -> None:
        self._rows.note(Event(self.flight.tick, kind, text))

    def _put(self, key: str, message: Any) -> None:
        self._bus.put(key, control.encode(message))

    def _wall_s(self) -> float:
        return self._counters.wall_s + self._clock() - self._started

    def _protocol(self) -> dict[str, Any]:
        return self._counters.summary(
            schedule=self._schedule,
            diagnostics=dict(zip(self._declared.diagnostics, self._commands.largest.tolist(), strict=True)),
            blocks_dropped=self._outbox.dropped,
        )

    @property
    def diagnostics(self) -> np.ndarray:
        """What the controllers reported of the last tick, `(N, K)`, as in `Telemetry`."""
        return self._commands.diagnostics

    @property
    def instruments(self) -> Instruments:
        """What can be read of the run at any moment."""
        meter, counters, listeners = self.air.meter, self._counters, self._admission.listeners
        members, outbox, waits, ticks = self._members, self._outbox, self._waiting.took, self._ticks
        return Instruments(
            self._run, self._mode, self.flight, meter, counters, members, listeners, outbox, waits, ticks, self._wall_s
        )

    @property
    def attended(self) -> bool:
        """Whether any node has not gone home yet."""
        return bool(self._members.present)
