"""The world of one flight: what all UAVs are told, and what becomes of what they say."""

from collections.abc import Iterable
from functools import partial

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.channel.medium import NO_LINKS, Medium
from meanflock.federation.account import ModelsHash
from meanflock.federation.backhaul import Backhaul
from meanflock.federation.ledger import Ledger
from meanflock.federation.mailbox import links_of, picked
from meanflock.federation.plan import Plan
from meanflock.federation.seat import name_of
from meanflock.swarm import mission, state
from meanflock.swarm.declared import most_memory
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.events import (
    Diverged,
    DutyExceeded,
    FlightEvent,
    GlobalDraw,
    Joined,
    LinksClamped,
    Lost,
    NoCheckpoint,
    Rejoined,
    RoundEnded,
    StatesRefused,
    TurnedBack,
    UploadsRefused,
)
from meanflock.swarm.events.base import counted
from meanflock.swarm.state import BEYOND_SENSE, Floats, Mask
from meanflock.swarm.stateful import Stateful, restore, state_of
from meanflock.swarm.wire.messages import Frames
from meanflock.worldsim.checkpoint import Memories, Resumption, encoded
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.consumption import Consumption
from meanflock.worldsim.counters import Counters, weight_spread
from meanflock.worldsim.downwash import Downwash
from meanflock.worldsim.failures import Reports
from meanflock.worldsim.faults import Script
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.merger import FrameMerger
from meanflock.worldsim.target import MetricTarget
from meanflock.worldsim.tick import Acts, Row, Senses
from meanflock.worldsim.vehicles.base import ignored

REPORT_EVERY_TICKS = 10


class World(Stateful):
    """One flight: a value and its next value. It knows no bus, no clock and no node.

    A tick is `move(acts, absent)` with an answer to `ask()`. Other threads may read the attributes, and must not change
    them.

    Attributes:
        plan: what is flown.
        scenario: that of the plan.
        flight: states, energies and metrics of the UAVs.
        air: the radio.
        ledger: the rounds.
        backhaul: the wire between stations.
        models: the hash of the models that were shared.
        target: the metric at which the flight ends.
        batteries_empty: number of UAVs whose battery was empty.
        over_duty: nodes whose radio has sent for longer than it may.
        counters: counters of the protocol; crews count in them, too.
        commands: the commands of the last tick.
        consumption: of the radios and computers.
    """

    stored = (
        "over_duty",
        "batteries_empty",
        "flight",
        "air",
        "counters",
        "ledger",
        "backhaul",
        "models",
        "target",
        "commands",
    )

    def __init__(self, plan: Plan, resume: Resumption | None = None, *, checkpoint_every: int = 0) -> None:
        """
        Args:
            plan: what is flown.
            resume: the checkpoint to continue from; None: start at tick 0.
            checkpoint_every: ticks between two checkpoints, a multiple of ten; 0 for none.

        Raises:
            BadInput: the checkpoint belongs to another scenario, or is incomplete.
        """
        self.plan = plan
        self.scenario = scenario = plan.scenario
        declared = plan.declared
        busy = declared.diagnostics.index(declared.busy) if declared.busy else None
        self.flight = Flight(scenario)
        self.air = Medium(plan)
        self.ledger = Ledger(plan)
        self.backhaul = Backhaul(plan)
        self.models = ModelsHash(plan)
        self.target = MetricTarget(scenario)
        self.counters = Counters()
        self.commands = Commands(
            scenario.uavs,
            scenario.dimensions,
            len(declared.diagnostics),
            busy,
            [declared.diagnostics.index(name) for name in declared.measured],
            plan.has_diagnostic,
            [rows for _, rows in mission.parts(scenario)],
        )
        self.consumption = Consumption(plan, self.flight, self.air, self.commands)
        # Ticks in which a group joins or leaves.
        self._group_ticks = set(np.unique([mission.joins(scenario), mission.leaves(scenario)]).tolist())
        self._script = Script(scenario)
        self._downwash = Downwash(scenario)
        self._merger = FrameMerger(self.ledger)
        self._checkpoint_every = checkpoint_every if plan.is_resumable else 0
        self.over_duty: set[int] = set()
        self.batteries_empty = 0
        self._all = np.ones(scenario.uavs, dtype=bool)
        self._awake: Mask = self._all  # UAVs that took part in the tick that was asked for last
        self._senses: Senses | None = None  # of the tick that was asked for and not flown yet
        self._noted: set[type] = set()  # events that are noted once
        if resume is not None:
            self._resume(resume)
        else:
            self.air.meter.initial(scenario.state_numbers * scenario.radio.bits_per_float)  # the mission plan
            self.flight.events += ignored(scenario)
        if plan.topology_draws:
            self._note_draw()

    @property
    def tick(self) -> int:
        """Number of ticks flown."""
        return self.flight.tick

    @property
    def over(self) -> bool:
        """Returns whether the mission has ended."""
        if self.ledger.is_done and self.scenario.stop == "rounds":
            return True
        return self.flight.over or bool(self.target.reached)

    def ask(self) -> Senses:
        """Begin a tick: faults begin, and frames arrive. Returns what the UAVs are told."""
        flight, tick = self.flight, self.flight.tick
        killed, leaders_killed, awake = self._begin_faults(tick)
        self._awake = awake
        present = self._present(tick, awake)
        due = self.ledger.deliver(tick, self.backhaul.gathered(self.air.due(tick), present), present)
        report = tick % REPORT_EVERY_TICKS == 0
        guided, goals = flight.guide.news(awake)
        every = self._checkpoint_every
        self._senses = Senses(
            tick=tick,
            states=flight.states,
            awake=awake,
            present=present,
            lost=flight.lost,
            idle=flight.idle,
            heard=_reaching(due, awake) if due else due,
            letters=self.ledger.letters,
            newest=self.ledger.newest,
            leads=self.ledger.leader_is_due(tick, present),
            rule_record=self.ledger.rule_record,
            report=report,
            checkpoint=report and every > 0 and tick % every == 0,
            guided=guided,
            goals=goals,
            killed=killed,
            leaders_killed=leaders_killed,
        )
        return self._senses

    def move(self, acts: Acts, absent: Mask) -> Row:
        """Fly the tick that was asked for.

        Args:
            acts: what the UAVs say.
            absent: (N,), UAVs without an answer; they keep their last command.
        """
        assert self._senses is not None
        flight, (tick, states, awake, present, *_) = self.flight, self._senses
        self.learn(acts.news, acts.reports)
        self._take(acts)
        if len(self._senses.guided):
            flight.guide.told(awake & ~absent)
        diverged = self.commands.store(acts.commands, ~absent, awake, flight.on_way)
        if len(diverged):
            flight.lose(diverged, Diverged, "an answer beyond all bounds")
        if flight.idle is not None:
            self.commands.accelerations[flight.idle] = 0.0
        self.air.serve(tick, states, present)
        links = self._transmit(acts, absent) if acts.outbox or self.ledger.is_busy(tick) else NO_LINKS
        gust = self._downwash.added(self._script.gust(tick, states), states, flight.waiting)
        flight.advance(self.commands.accelerations, gust)
        self._watch_duty()
        if flight.last_arrival == flight.tick:
            self.air.meter.mark(flight.arrival_tick == flight.tick)
        weights = self._learned(acts.models, awake & ~flight.lost) if acts.models is not None else None
        memories = acts.memories
        on = self._all if flight.off is None else ~flight.off
        if memories is not None and not (awake[on].all() and memories.present[on].all()):
            self._note_missing(awake & ~absent & ~memories.present)
            memories = None
        self._senses = None
        return self._row(links, weights, memories)

    def _transmit(self, acts: Acts, absent: Mask) -> np.ndarray:
        """Transmit the frames of this tick and the rest of earlier ones, and close the hops of rounds; returns the
        links that were used, (K, 7)."""
        assert self._senses is not None
        air, ledger, (tick, states, awake, present, *_) = self.air, self.ledger, self._senses
        frames, rejected = self._merger.merged(tick, acts.outbox, present, air.meter)
        for error, where in rejected:
            self._drop(error, where)
        self.models.add(frames)
        cut, noise = self._script.cut(tick, states), self._script.noise(tick)
        on_air = ledger.transmitted(tick, frames, present, partial(air.acknowledge, tick, states, cut, noise))
        clamped = air.clamped
        links = air.send(tick, self.backhaul.spread(on_air, air.serving.node, awake), states, cut, noise)
        if air.clamped > clamped == 0:
            self.note(LinksClamped(tick, air.clamped))
        for ended in ledger.close(tick, frames, on_air, links, present, acts.has_leader, self.note):
            completed = self._completed(ended, awake & ~absent)
            self.note(completed)
            if self.target.is_met(completed):
                self.target.reach(completed, self.consumption.totals()["energy_total_J"])
        return links

    def begun(self) -> Row:
        """The row of the tick at which the flight begins."""
        return self._row(NO_LINKS)

    def note(self, event: FlightEvent) -> None:
        """Record an event of this tick."""
        self.flight.events.append(event)

    def note_once(self, event: FlightEvent) -> None:
        """Record an event of this tick, unless one of its type was recorded."""
        if type(event) not in self._noted:
            self._noted.add(type(event))
            self.note(event)

    def learn(self, news: Iterable[FlightEvent], reports: Reports) -> None:
        """Take what became of the nodes: UAVs are lost or rejoin, and all else is recorded. Take the failures that
        nodes report of the tick that was asked for last."""
        for event in news:
            match event:
                case Lost():
                    self.flight.lose(np.array(event.uavs, dtype=np.intp), Lost, event.reason)
                case Rejoined():
                    self.flight.rejoin(np.array(event.uavs, dtype=np.intp), event.node)
                case _:
                    self.note(event)
        self.flight.events += reports.events(self.tick, self._awake, self.plan.groups)
        if reports.leader_failed:
            self.ledger.fail()
        self.ledger.fail_at(reports.unaveraged)
        if reports.found_draw:
            self._note_draw()

    def checkpoint(self, memories: Memories, wall_s: float, block: int) -> bytes:
        """The state between two ticks, which `checkpoint.decoded` reads.

        Args:
            memories: of the controllers. wall_s: wall-clock time flown so far. block: number of the block of telemetry
                that carries the checkpoint.
        """
        parts = {
            "block": block,
            "wall_s": wall_s,
            "world": state_of(self),
            "memory": memories.arrays,
            "has_memory": memories.present,
        }
        return encoded(self.scenario, parts)

    def _resume(self, resume: Resumption) -> None:
        resume.check(self.scenario)
        try:
            restore(self, resume.checkpoint["world"])
            self.counters.wall_s = float(resume.checkpoint["wall_s"])
            self.flight.rehash(resume.history)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise BadInput(f"the run cannot be resumed: {error}") from error

    def _row(
        self,
        links: np.ndarray,
        weights: tuple[Floats, float] | None = None,
        memories: Memories | None = None,
    ) -> Row:
        flight, commands = self.flight, self.commands
        events, flight.events = flight.events, []
        diagnostics = commands.diagnostics
        if self.plan.shown:
            diagnostics = np.concatenate([diagnostics, flight.shown()], axis=1)
        return Row(
            flight.tick,
            flight.states,
            flight.status,
            commands.accelerations,
            diagnostics,
            links,
            events,
            weights,
            memories,
        )

    def _begin_faults(self, tick: int) -> tuple[np.ndarray, int, Mask]:
        """Kill and pause UAVs as the fault script says.

        Returns:
            The UAVs and the number of leaders that are killed; the UAVs that are awake, (N,).
        """
        flight = self.flight
        killed = self._script.killed(tick)
        if tick in self._group_ticks:
            self._begin_groups(tick, killed)
        if flight.guide.is_there:
            self._guide(tick)
        if not self.scenario.faults:
            return killed, 0, self._all if flight.off is None else ~flight.off
        flight.events += self._script.events(tick)
        flight.lose(killed, Lost, KILLED)
        awake = ~self._script.paused(tick)
        return killed, self._script.leaders_lost(tick), awake if flight.off is None else awake & ~flight.off

    def _guide(self, tick: int) -> None:
        """Move goals, send UAVs home whose battery is low, and land those that are there or whose battery is empty."""
        flight, guide, energy = self.flight, self.flight.guide, self.scenario.energy
        guide.move(tick)
        if guide.landing.any():
            flight.land(np.flatnonzero(guide.landing), "at a landing place, with a low battery")
            guide.landing[:] = False
        if energy.battery_J is None or tick % REPORT_EVERY_TICKS:
            return
        spent = self.consumption.of_uavs_J
        aloft = np.ones_like(self._all) if flight.idle is None else ~flight.idle
        empty = np.flatnonzero(aloft & (spent >= energy.battery_J))
        if energy.empty == "falls":
            flight.lose(empty, Lost, "with an empty battery, which lets it fall")
        else:
            flight.land(empty, "with an empty battery")
        self.batteries_empty += len(empty)
        low = aloft & ~guide.homeward & (spent >= (1.0 - energy.reserve) * energy.battery_J)
        low[empty] = False
        if low.any():
            uavs = np.flatnonzero(low)
            guide.send_home(uavs, state.position(flight.states[uavs]))
            self.note(TurnedBack(tick, tuple(uavs.tolist())))

    def _begin_groups(self, tick: int, killed: NDArray[np.intp]) -> None:
        """Let groups join and leave as they are to, but for UAVs that are `killed` in this tick."""
        dt = self.scenario.dt
        for group, rows in mission.parts(self.scenario):
            uavs = np.arange(rows.start, rows.stop)
            joining = np.setdiff1d(uavs[~self.flight.lost[uavs]], killed)
            if tick and tick == group.joins_in(dt) and len(joining):
                self.note(Joined(tick, tuple(joining.tolist()), group.name))
            if tick == group.leaves_in(dt):
                self.flight.land(uavs, f"group {group.name} leaves")

    def _present(self, tick: int, awake: Mask) -> Mask:
        """Mask (N + B,) of the nodes that send and receive: UAVs that are `awake` (N,), then stations."""
        if not self.scenario.stations:
            return awake
        return np.concatenate([awake, self._script.present_stations(tick)])

    def _take(self, acts: Acts) -> None:
        """Take what the nodes say but commands and frames."""
        flight, ledger, counters = self.flight, self.ledger, self.counters
        if len(acts.failed):
            flight.lose(
                np.sort(acts.failed).astype(np.intp), Diverged, "the controller failed or left the finite numbers"
            )
        if acts.rule_record is not None:
            try:
                ledger.take_record(acts.rule_record)
            except MessageRejected as error:
                self._drop(error, "the record of the aggregation rule")
        ledger.wait_at(acts.waiting)
        counters.steered += acts.steered
        if len(acts.refused_uploads):
            uploads = np.unique(acts.refused_uploads).tolist()  # several nodes may refuse one
            counters.uploads_refused += len(uploads)
            ledger.refuse(uploads)
            self.note(UploadsRefused(flight.tick, tuple(uploads)))
        if len(acts.refused_states):
            self._count_implausible(set(acts.refused_states.tolist()))

    def _count_implausible(self, uavs: set[int]) -> None:
        """Count each UAV once a tick, however many nodes refuse its states; name it once a run."""
        self.counters.states_refused += len(uavs)
        if new := sorted(uavs - self.counters.implausible):
            self.counters.implausible |= uavs
            self.note(StatesRefused(self.flight.tick, tuple(new)))

    def _watch_duty(self) -> None:
        """Name nodes that have sent for longer than they may, each once."""
        limit = self.scenario.radio.duty_max
        if limit is None or self.flight.tick % REPORT_EVERY_TICKS:
            return
        if over := sorted(set(np.flatnonzero(self.consumption.duty > limit).tolist()) - self.over_duty):
            self.over_duty.update(over)
            self.note(DutyExceeded(self.flight.tick, tuple(name_of(self.scenario, node) for node in over), limit))

    def _completed(self, ended: RoundEnded, replied: Mask) -> RoundEnded:
        """A round with what it cost so far, and the means of the diagnostics of UAVs that `replied` (N,)."""
        meter = self.air.meter
        counted = replied & self.flight.on_way
        names = self.plan.declared.diagnostics
        means = {name: mean for name, mean in zip(names, self.commands.means(counted), strict=True) if mean is not None}
        bits, airtime_s = int(meter.total("payload_bits")), meter.total("airtime_s")
        return structs.replace(ended, bits=bits, airtime_s=airtime_s, diagnostics=means)

    def _learned(self, models: Floats, alive: Mask) -> tuple[Floats, float] | None:
        """The weights of the leader's UAV, and the spread of the models (N, W) of all UAVs that are `alive` (N,)."""
        is_bounded = kernels.largest(models) < BEYOND_SENSE  # false for NaN, too
        bounded: Mask = self._all if is_bounded else np.logical_and.reduce(np.abs(models) < BEYOND_SENSE, axis=1)
        counted = bounded & alive
        if not counted.any():
            return None
        spread = self.counters.spread = weight_spread(models if counted.all() else models[counted])
        leader = self.scenario.federation.leader
        return np.where(bounded[leader], models[leader], 0.0), spread

    def _note_draw(self) -> None:
        """Record that a plug-in draws from a global random generator; meanflock's own do not."""
        if self.plan.foreign_plugins:
            self.note_once(GlobalDraw(self.tick, self.plan.foreign_plugins))

    def _note_missing(self, uavs: Mask) -> None:
        """Record that agents replied without the memory of `uavs` (N,): it exceeds the room of a checkpoint."""
        methods = {repr(group.scenario.method): None for group in self.plan.groups if uavs[group.uavs].any()}
        if methods:
            room = f"{most_memory(self.scenario.uavs) / 2**20:,.0f} MiB for {counted(self.scenario.uavs)}"
            which = f"the memory of controller {' and '.join(methods)}"
            self.note_once(NoCheckpoint(self.tick, f"{which} does not fit into {room}"))

    def _drop(self, error: MessageRejected, where: str) -> None:
        if dropped := self.counters.drop(error, where, self.flight.tick):
            self.note(dropped)


KILLED = "killed by the fault script"


def _reaching(due: list[Frames], awake: Mask) -> list[Frames]:
    """The frames `due` in this tick, reduced to links that end at UAVs that are `awake` (N,)."""
    if awake.all():
        return due
    parts = [picked(batch, awake[links_of(batch)[:, 1]]) for batch in due]
    return [part for part in parts if part is not None]
