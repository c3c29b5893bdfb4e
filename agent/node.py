"""The agent node: M UAVs as rows of one process, flown by the controller the scenario names."""

import logging

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.byzantine import Byzantine
from meanflock.agent.controllers.base import Broadcast, Received
from meanflock.agent.feedback import Feedback
from meanflock.agent.guarded import Guarded
from meanflock.agent.heads import Heads
from meanflock.agent.rows import picked
from meanflock.swarm import faults, state
from meanflock.swarm.ascending import contains, distinct
from meanflock.swarm.declared import MAX_MEMORY_BYTES
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.model import BEYOND_SENSE
from meanflock.swarm.rounds import Rounds
from meanflock.swarm.scenario import Scenario, decode
from meanflock.swarm.wire import payload
from meanflock.swarm.wire.control import FLOAT_OF_BITS, decode_record, encode_record, expect
from meanflock.swarm.wire.messages import NOBODY, Act, FrameKind, Frames, Sense, Welcome

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

log = logging.getLogger("meanflock.agent")

_STATE = np.dtype(np.float64)
_RESIDUALS = "meanflock.residuals"  # in a checkpoint, beside the arrays of the controller


class Agent:
    """What a node does with a Sense; whoever carries the messages calls `act`."""

    def __init__(self, welcome: Welcome) -> None:
        """Raises BadInput where the controller cannot begin."""
        self.uavs = np.array(welcome.uavs, dtype=np.intp)
        self.complaints: list[str] = []  # what the world should hear of, since it was last asked
        self._names = self.uavs.astype(np.int32)  # as frames have them
        self._scenario: Scenario = decode(welcome.scenario)
        self._declared = self._scenario.declared
        self._float = FLOAT_OF_BITS[self._scenario.radio.bits_per_float]
        self._rounds = Rounds(self._scenario, self.uavs)
        self._rounds.draw_ahead()
        self._byzantine = Byzantine(self._scenario)
        self._heads = Heads(self._scenario, self.uavs)
        self._up, self._down = payload.upload(self._scenario), payload.broadcast(self._scenario)
        self._feedback = Feedback(self._up, len(self.uavs), kept=self._scenario.keeps_residuals)
        self._period = self._scenario.period_ticks if self._declared.is_federated else 0  # of rounds; 0 without any
        self._own = np.zeros(self._scenario.uavs, dtype=bool)
        self._own[self.uavs] = True
        self._failed = np.zeros(len(self.uavs), dtype=bool)
        self._any_failed = False
        self._pauses = any(isinstance(fault, faults.Pause) for fault in self._scenario.faults)
        plan = expect("initial_states", welcome.initial_states, (self._scenario.uavs, state.SIZE), self._float)
        self._controller = Guarded(self._scenario, self.uavs, self.complaints)
        self._memory = self._controller.init(plan.astype(np.float64))
        if welcome.memory:
            self._resume(welcome.memory)

    @property
    def models(self) -> Floats:
        """What each row has learned so far, `(M, W)`."""
        return self._controller.report(self._memory) if self._declared.weights else np.zeros((len(self.uavs), 0))

    def act(self, sense: Sense) -> Act:
        """One tick. Whoever reads the Sense has seen to it that it has the states of as many UAVs as this node's.

        Raises:
            MessageRejected: a frame in it does not fit this node; nothing has changed.
        """
        tick = sense.tick
        for frames in sense.inbox:
            self._check(frames)

        # 0. Rows the fault script pauses are as they were when the tick is over, whatever the others do.
        asleep = self._asleep(tick) if self._pauses else None
        before, controller = self._memory, self._controller
        controller.begin(asleep)
        # 1. Take in what the radio brought: a global model goes to the controller, as do frames of other UAVs, and the
        #    head of a cluster keeps the uploads of a round.
        received = self._receive(sense.inbox) if sense.inbox else ()
        # 2. Speak in the rounds: the participants' models as they are now, and the means of clusters once all their
        #    uploads have come or are lost.
        outbox: list[Frames] = []
        refused: list[int] = []
        if self._period and tick % self._period == 0 and (number := self._rounds.opens(tick)):
            outbox += self._uploads(number, asleep)
        if averages := self._rounds.relays(tick):
            silent = self._failed if asleep is None else self._failed | asleep
            relays, refused = self._heads.relay(averages, self.uavs[controller.or_broken(silent)])
            outbox += relays
        # 3. Let the controller fly.
        step, commands, largest = controller.step(self._memory, tick, sense.states, received)
        self._memory = step.memory
        # 4. A row whose numbers have left all bounds is reported and silenced; the others go on.
        if asleep is not None:
            commands[asleep] = 0.0
            self._memory = picked(asleep, before, self._memory)
        if sense.checkpoint:
            controller.look(self._memory)
        learned = controller.report(self._memory) if sense.report and self._declared.weights else None
        if controller.broken is not None:
            commands[controller.broken] = np.nan
        if self._any_failed or controller.broken is not None or not largest < BEYOND_SENSE:  # NaN is below nothing
            self._silence(commands)
            if learned is not None:
                learned = np.where(self._failed[:, None], 0.0, learned)
        for number, broadcast in enumerate(step.broadcasts):
            outbox += self._frames_of(number, broadcast)
        if not (sense.report or sense.checkpoint or refused or self._any_failed or len(step.refused)):
            return Act(sense.run, tick, commands, outbox=tuple(outbox))
        return Act(
            sense.run,
            tick,
            commands,
            self._names[self._failed],
            np.concatenate([~np.array(refused, np.int32), self._others(step.refused)]),  # uploads, and states
            learned,
            self._kept() if sense.checkpoint else b"",
            tuple(outbox),
        )

    def _others(self, refused: NDArray[np.integer]) -> NDArray[np.int32]:
        """UAVs that are refused, each once; nobody refuses itself, though it may one in the row beside it."""
        found = distinct(refused).astype(np.int32)
        return found if len(self.uavs) > 1 else found[found != self._names[0]]

    # -- what goes out ------------------------------------------------------------------------------------------

    def _silence(self, commands: Floats) -> None:
        """Zeros what failed rows remember and say, so that nothing non-finite ever leaves or spreads."""
        beyond = ~np.all(np.abs(commands) < BEYOND_SENSE, axis=-1)
        self._controller.note_beyond(commands, beyond & ~self._failed)
        self._failed = self._failed | beyond
        self._any_failed = bool(self._failed.any())
        commands[self._failed] = 0.0
        nothing = {name: np.zeros_like(array) for name, array in self._memory.items()}
        self._memory = picked(self._failed, nothing, self._memory)

    def _frames_of(self, number: int, broadcast: Broadcast) -> list[Frames]:
        """A broadcast as it is transmitted; floats as the radio has them, rows that they cannot say left out."""
        said, rows = broadcast.payload, broadcast.rows
        names = self._names if rows is None else self._names[rows]
        failed = None if not self._any_failed else self._failed if rows is None else self._failed[rows]
        if said.dtype.kind == "f":
            with np.errstate(over="ignore"):
                said = said.astype(self._float)  # infinite where the radio's floats end
            fits = np.isfinite(said).all(axis=-1)
            if not fits.all():
                failed = ~fits if failed is None else failed | ~fits
        if failed is not None:
            names, said = names[~failed], said[~failed]
        return [Frames(FrameKind.STATE, number, names, said)] if len(names) else []

    # -- what comes in ------------------------------------------------------------------------------------------

    def _check(self, frames: Frames) -> None:
        """A batch this node can receive, or MessageRejected."""
        rows, everyone = len(frames.source), self._scenario.uavs
        is_global = frames.kind == FrameKind.GLOBAL
        if frames.kind == FrameKind.RELAY or (is_global and not self._declared.is_federated):
            raise MessageRejected("wrong-kind", f"{frames.kind.name} frames are not for an agent")
        if frames.links is None:
            raise MessageRejected("wrong-shape", "frames without links")
        sent, to = frames.links[:, 0], frames.links[:, 1]
        if not (_within(frames.source, everyone) and _within(to, everyone) and self._own[to].all()):
            raise MessageRejected("wrong-shape", "frames name UAVs that are not here")
        if not _within(sent, rows):
            raise MessageRejected("wrong-shape", "links beyond the payload")
        if is_global:
            self._down.check(frames.payload, rows)
        elif frames.kind == FrameKind.UPLOAD:
            self._heads.check(frames)

    def _receive(self, inbox: tuple[Frames, ...]) -> tuple[Received, ...]:
        """Global models into the memory, uploads to the heads; what other UAVs said, by row."""
        received = []
        for frames in inbox:
            assert frames.links is not None
            if frames.kind == FrameKind.UPLOAD:
                self._heads.collect(frames)
                continue
            sent, row = frames.links[:, 0].astype(np.intp), self.uavs.searchsorted(frames.links[:, 1])
            if frames.kind == FrameKind.GLOBAL:
                self._memory = self._controller.set(self._memory, row, self._down.decode(frames.payload[sent]))
                continue
            said = frames.payload.astype(np.float64) if frames.payload.dtype.kind == "f" else frames.payload
            links = np.stack([sent, row], axis=-1)
            received.append(Received(frames.round, frames.source.astype(np.intp), said, links))
        return tuple(received)

    # -- rounds -------------------------------------------------------------------------------------------------

    def _uploads(self, number: int, asleep: Mask | None) -> list[Frames]:
        rows = self._rounds.rows(number)
        silent = self._failed if asleep is None else self._failed | asleep
        rows = rows[~self._controller.or_broken(silent)[rows]]
        if not len(rows):
            return []
        models = self._controller.get(self._memory, rows)
        rows = rows[~self._controller.or_broken(silent)[rows]]
        source, models = self._names[rows], models[rows]
        sent = self._byzantine.distort(number, source, self._feedback.encode(rows, models), self._up)
        fits = self._up.sound(sent)  # a model beyond the range of the payload cannot be sent
        return [Frames(FrameKind.UPLOAD, number, source[fits], sent[fits])] if fits.any() else []

    # -- the fault script, and checkpoints ----------------------------------------------------------------------

    def _asleep(self, tick: int) -> Mask | None:
        """Which rows the fault script pauses in this tick, (M,); None for none."""
        paused = np.array(faults.paused(self._scenario.faults, tick, self._scenario.dt), dtype=np.intp)
        asleep = contains(paused, self.uavs)
        return asleep if asleep.any() else None

    def _kept(self) -> bytes:
        """All that the rows remember, as a record; nothing where that is more than a checkpoint has room for."""
        kept = dict(self._memory)
        if self._feedback.residuals is not None:
            kept[_RESIDUALS] = self._feedback.residuals
        size = sum(array.nbytes for array in kept.values())
        if size * self._scenario.uavs > MAX_MEMORY_BYTES * len(self.uavs):
            return b""
        return encode_record({name: np.ascontiguousarray(array) for name, array in kept.items()})

    def _resume(self, record: bytes) -> None:
        """Goes on with what its rows had in memory, a record of `_kept`; BadInput where that does not fit."""
        try:
            kept = decode_record(record)
            if (residuals := self._feedback.residuals) is not None:
                found = kept.pop(_RESIDUALS, NOBODY)
                self._feedback.residuals = expect("residuals", found, residuals.shape, np.float64).copy()
            if set(kept) != set(self._memory):
                raise MessageRejected("wrong-shape", f"a memory of {sorted(kept)}, expected {sorted(self._memory)}")
            for name, array in self._memory.items():
                self._memory[name] = expect(name, kept[name], array.shape, array.dtype).copy()
        except MessageRejected as error:
            uavs = ", ".join(map(str, self.uavs))
            raise BadInput(f"what UAV {uavs} had in memory does not fit this controller: {error}") from error


def _within(numbers: NDArray[np.int32], end: int) -> bool:
    """Whether all of them are 0…end − 1."""
    return bool((numbers.astype(np.uint32) < end).all())  # what is negative is very large
