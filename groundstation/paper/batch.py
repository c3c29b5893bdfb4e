"""Many seeds of one scenario at once: rows of one learner, no bus, no codec, no disk.

Each run of a batch is the run `Engine` would fly alone, to the last bit: the same learner, radio, leader and books,
floats narrowed to the radio's width where they cross it, and every sum taken over a row of the same length.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.feedback import Feedback
from agent.heads import Heads
from agent.learner import Learner
from agent.minds import Minds, Outcome
from agent.node import BEYOND_SENSE
from agent.offline import Program
from channel.air import Air
from groundstation.paper.flights import Flights
from groundstation.paper.series import Curves, Record, spreads
from groundstation.paper.statecast import StateCast
from leader.node import Leader
from swarm import model, payload, scenario, state
from swarm.codec import FLOAT_OF_BITS
from swarm.errors import BadInput
from swarm.messages import DIAGNOSTICS, FrameKind, Frames, Sense, Welcome
from swarm.methods import Method
from swarm.rounds import Rounds
from swarm.scenario import Scenario
from worldsim.flight import LOST
from worldsim.summary import summary

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

REPORT_EVERY_TICKS = 10  # as the world does: the weight spread of the summary is that of the last report


@dataclass(frozen=True)
class Flown:
    """One run of a batch.

    summary: as of `Engine`, but mode "batch", and wire bytes None: nothing was encoded.
    record: its curves, and what was traced. minds: what its N UAVs had learned at the end.
    """

    scenario: Scenario
    summary: dict[str, Any]
    record: Record
    minds: Minds


@dataclass
class _Run:
    """What is kept of a run one by one."""

    scenario: Scenario
    number: int  # its place in the batch as it was at take-off
    learner: Learner  # of its own seed: the fit of the density draws sample points
    rounds: Rounds
    air: Air
    leader: Leader | None
    heads: Heads
    bits: int = 0  # of payload, so far
    spread: float | None = None
    rounds_done: int = 0
    speech: list[Frames] = field(default_factory=list)  # of this tick


class Batch:
    """R runs of one scenario that differ in their seeds. Rows of UAVs are run by run: row = run · N + UAV."""

    def __init__(
        self,
        flown: Scenario,
        seeds: Sequence[int],
        *,
        minds: Sequence[Minds] | None = None,
        trace: Sequence[int] = (),
    ) -> None:
        """`minds`: what each run takes off with instead of knowing nothing. `trace`: seeds to keep in full.

        Raises:
            BadInput: the scenario has a fault script or false uploads, which only whole nodes can play.
        """
        federation = flown.federation
        if flown.faults or federation.byzantine_fraction or federation.aggregation != "fedavg":
            raise BadInput("a batch averages with fedavg, without `faults` and `federation.byzantine_fraction`")
        scenarios = [msgspec.structs.replace(flown, seed=seed) for seed in seeds]
        self._scenario, self._n = flown, flown.uavs
        self._method, self._shared = flown.method, model.shared(flown.method)
        self._averaged = FrameKind.RELAY if federation.clusters > 1 else FrameKind.UPLOAD  # by the leader
        self._float = FLOAT_OF_BITS[flown.radio.bits_per_float]
        self._learner = Learner(flown)
        self._flights = Flights(scenarios)
        plan = self._flights.states[0].astype(self._float)
        self._runs = [self._start(one, number, plan) for number, one in enumerate(scenarios)]
        self._program = Program(flown, plan.astype(np.float64)) if self._method is Method.OFFLINE else None
        if minds is None:
            minds = [run.learner.init(self._n, plan.astype(np.float64)) for run in self._runs]
        self._minds = Minds(
            np.concatenate([one.value for one in minds]), np.concatenate([one.density for one in minds])
        )
        rows = len(self._runs) * self._n
        self._up, self._down = payload.upload(flown), payload.broadcast(flown)
        self._feedback = Feedback(self._up, rows, kept=flown.keeps_residuals)
        self._diverged = np.zeros(rows, dtype=bool)
        self._cast: StateCast | None = None
        if self._method is Method.HJB and StateCast.fits(flown):
            self._cast = StateCast(flown, list(seeds))
            for run, meter in zip(self._runs, self._cast.meters, strict=True):
                run.air.meter = meter
        self._cast_due: tuple[Mask, NDArray] | None = None
        self._residual_max = np.zeros((len(self._runs), 2))  # |e_H|, |e_F|
        keeps_states = self._method is Method.HJB or flown.federation.state_period > 0
        self._known = np.repeat(plan.astype(np.float64)[None], rows, axis=0) if keeps_states else None
        for run in self._runs:
            run.air.meter.initial(state.SIZE * flown.radio.bits_per_float)
            run.bits = _payload_bits(run)
        self._curves = Curves(flown, list(seeds), trace)

    def fly(self) -> list[Flown]:
        """All runs, in the order of the seeds."""
        started = time.monotonic()
        flown: dict[int, Flown] = {}
        diagnostics = np.zeros((len(self._runs), self._n, len(DIAGNOSTICS)))
        while self._runs:
            self._observe(diagnostics)
            over = self._flights.over
            if over.any():
                if self._cast:
                    self._cast.settle()
                wall_s = (time.monotonic() - started) / self._curves.runs
                for row in np.flatnonzero(over):
                    flown[self._runs[row].number] = self._finish(int(row), wall_s)
                self._keep(~over)
                diagnostics = diagnostics[~over]
                continue
            diagnostics = self._tick()
        return [flown[number] for number in sorted(flown)]

    def _start(self, one: Scenario, number: int, plan: NDArray) -> _Run:
        leader = None
        if self._method.is_federated:
            leader = Leader(Welcome(0, "leader", (), 0, scenario.encode(one), plan))
        heads = Heads(one, np.arange(self._n))
        return _Run(one, number, Learner(one), Rounds(one), Air(one), leader, heads)

    def _tick(self) -> Floats:
        """The steps of `agent.node`, `leader.node` and `worldsim.node`, for all runs; the diagnostics `(R, N, 3)`."""
        tick, states = self._flights.tick, self._flights.states
        flat = states.reshape(-1, state.SIZE)
        # 1. Deliver: global models overwrite, states replace what was known, uploads reach the leader.
        self._receive(tick, states)
        # 2. Speak, with the models as they are now.
        due = self._speak(tick, states)
        # 3. Learn and act.
        if self._known is not None:
            own = np.arange(len(flat))
            self._known[own, own % self._n] = flat
        outcome = self._think(tick, flat)
        numbers = self._settle(outcome)
        accelerations = numbers[:, : state.AXES].reshape(-1, self._n, state.AXES)
        diagnostics = numbers[:, state.AXES :].reshape(-1, self._n, len(DIAGNOSTICS))
        # 4. The world loses whose learner diverged, carries what was said, and moves.
        self._lose_diverged()
        for run, of_run in zip(self._runs, states, strict=True):
            if run.speech:
                run.air.send(tick, run.speech, of_run)
                run.speech = []
                run.bits = _payload_bits(run)
        self._cast_due = due
        np.maximum(self._residual_max, np.abs(diagnostics[..., :2]).max(axis=1), out=self._residual_max)
        self._flights.advance(accelerations)
        if tick % REPORT_EVERY_TICKS == 0:
            self._report()
        return diagnostics

    def _think(self, tick: int, states: Floats) -> Outcome:
        if self._program is None:
            return self._learner.step(self._minds, states, self._known)
        return Outcome.of(self._minds, np.tile(self._program(tick), (len(self._runs), 1)))

    def _settle(self, outcome: Outcome) -> Floats:
        """Takes over the minds; silences rows that are no longer finite. [a (2), e_H, e_F, φ_G] by row, `(RN, 5)`."""
        numbers = outcome.numbers
        self._minds = outcome.minds
        if not outcome.largest < BEYOND_SENSE or self._diverged.any():  # NaN is below nothing
            self._diverged |= ~np.all(np.abs(numbers) < BEYOND_SENSE, axis=-1)
            numbers[self._diverged] = 0.0
            keep = ~self._diverged[:, None, None]
            self._minds = Minds(np.where(keep, self._minds.value, 0.0), np.where(keep, self._minds.density, 0.0))
        return numbers

    def _lose_diverged(self) -> None:
        if not self._diverged.any():
            return
        diverged = self._diverged.reshape(-1, self._n)
        for row in np.flatnonzero(diverged.any(axis=-1)):
            self._flights.lose(
                int(row), np.flatnonzero(diverged[row]), "diverged", "the learner left the finite numbers"
            )

    # -- the radio ----------------------------------------------------------------------------------------------

    def _receive(self, tick: int, states: state.States) -> None:
        if self._cast_due is not None:
            assert self._known is not None
            heard, payload = self._cast_due
            known = self._known.reshape(-1, self._n, self._n, state.SIZE)
            np.copyto(known, payload[:, None, :, :], where=heard[..., None])
        for row, run in enumerate(self._runs):
            due = run.air.due(tick)
            for frames in due:
                self._take_in(row, run, frames)
            if run.leader is not None and run.rounds.is_open(tick):
                averaged = tuple(_with_links(frames) for frames in due if frames.kind == self._averaged)
                act = run.leader.act(Sense(0, tick, states[row, :0], False, averaged))
                run.speech += act.outbox
                run.rounds_done += len(act.outbox)

    def _take_in(self, row: int, run: _Run, frames: Frames) -> None:
        """See `agent.node`: what the UAVs of a run do with a batch of delivered frames."""
        assert frames.links is not None
        sent, rows = frames.links[:, 0], row * self._n + frames.links[:, 1].astype(np.intp)
        if frames.kind == FrameKind.GLOBAL:
            self._minds = self._minds.with_models(rows, self._shared, self._down.decode(frames.payload[sent]))
        elif frames.kind == FrameKind.UPLOAD and self._averaged == FrameKind.RELAY:
            run.heads.collect(frames)
        elif frames.kind == FrameKind.STATE and self._known is not None:
            self._known[rows, frames.source[sent]] = frames.payload[sent]
            if self._method.learns_density:
                own = slice(row * self._n, (row + 1) * self._n)
                of_run = Minds(self._minds.value[own], self._minds.density[own])
                density = self._minds.density.copy()
                density[own] = run.learner.refit(of_run, self._known[own]).density
                self._minds = Minds(self._minds.value, density)

    def _speak(self, tick: int, states: state.States) -> tuple[Mask, NDArray] | None:
        """Uploads and state broadcasts go into the `speech` of their runs; hjb's come back, for the next tick."""
        number = self._runs[0].rounds.opens(tick)
        if number:
            models = self._minds.models()[:, self._shared]
            for row, (run, out) in enumerate(zip(self._runs, self._diverged.reshape(-1, self._n), strict=True)):
                source = run.rounds.participants(number)
                source = source[~out[source]]
                rows = row * self._n + source
                said = self._feedback.encode(rows, models[rows])
                fits = self._up.sound(said)
                if fits.any():
                    run.speech.append(Frames(FrameKind.UPLOAD, number, source[fits].astype(np.int32), said[fits]))
        if self._runs[0].rounds.relays(tick):
            for run, out in zip(self._runs, self._diverged.reshape(-1, self._n), strict=True):
                run.speech += run.heads.relay(tick, np.flatnonzero(out))[0]
        period = 1 if self._method is Method.HJB else self._scenario.federation.state_period
        if self._program is not None or not period or tick % period or tick == 0:
            return None
        speaks = ~self._diverged.reshape(-1, self._n)
        payload = states.astype(self._float)
        if self._cast is not None:
            return self._cast.send(states, speaks), payload
        for run, of_run, speaker in zip(self._runs, payload, speaks, strict=True):
            source = np.flatnonzero(speaker)
            if len(source):
                run.speech.append(Frames(FrameKind.STATE, 0, source.astype(np.int32), of_run[source]))
        return None

    # -- the books ----------------------------------------------------------------------------------------------

    def _report(self) -> None:
        models = self._minds.models().reshape(len(self._runs), self._n, -1)
        known = np.isfinite(models).all(axis=-1) & (self._flights.status != LOST)
        for run, spread in zip(self._runs, spreads(models, known).tolist(), strict=True):
            if spread == spread:  # of somebody
                run.spread = spread

    def _observe(self, diagnostics: Floats) -> None:
        numbers = [run.number for run in self._runs]
        if self._cast is not None:
            for run in self._runs:
                run.bits = _payload_bits(run)
        bits = [run.bits for run in self._runs]
        self._curves.tick(numbers, self._flights, bits)
        if self._curves.samples(self._flights.tick):
            self._curves.sample(numbers, self._flights, bits, diagnostics, self._minds)

    def _finish(self, row: int, wall_s: float) -> Flown:
        run = self._runs[row]
        learns = self._method.learns_density
        protocol: dict[str, Any] = {
            "rounds": run.rounds_done,
            "hjb_residual_max": float(self._residual_max[row, 0]),
            "fpk_residual_max": float(self._residual_max[row, 1]) if learns else None,
            "weight_spread_final": run.spread,
            "nodes_lost": 0,
            "nodes_rejoined": 0,
            "uploads_refused": 0,
            "dropped_messages": {},
            "held_commands": None,
            "realtime": None,
            "telemetry_blocks_dropped": 0,
        }
        flight = self._flights.flight(row)
        name = f"batch-{run.scenario.method}-s{run.scenario.seed}"
        record = summary(flight, run.air.meter, name, "batch", wall_s, protocol)
        _forget_wire_bytes(record)
        own = slice(row * self._n, (row + 1) * self._n)
        minds = Minds(self._minds.value[own].copy(), self._minds.density[own].copy())
        return Flown(run.scenario, record, self._curves.of(run.number, flight), minds)

    def _keep(self, rows: Mask) -> None:
        self._runs = [run for run, kept in zip(self._runs, rows, strict=True) if kept]
        each = np.repeat(rows, self._n)
        self._flights.keep(rows)
        self._minds = Minds(self._minds.value[each], self._minds.density[each])
        self._diverged = self._diverged[each]
        self._residual_max = self._residual_max[rows]
        self._feedback.keep(each)
        if self._known is not None:
            self._known = self._known[each]
        if self._cast is not None:
            self._cast.keep(rows)
        if self._cast_due is not None:
            self._cast_due = self._cast_due[0][rows], self._cast_due[1][rows]


def _payload_bits(run: _Run) -> int:
    return int(run.air.meter.total("payload_bits"))


def _with_links(frames: Frames) -> Frames:
    """Only the payloads that arrived, as the world hands them to the leader."""
    assert frames.links is not None
    needed, row = np.unique(frames.links[:, 0], return_inverse=True)
    links = np.stack([row.reshape(-1).astype(np.int32), frames.links[:, 1]], axis=-1)
    return Frames(frames.kind, frames.round, frames.source[needed], frames.payload[needed], links)


def _forget_wire_bytes(record: dict[str, Any]) -> None:
    record["wire_bytes"] = None
    for traffic in record["radio"]["traffic"].values():
        traffic["wire_bytes"] = None
