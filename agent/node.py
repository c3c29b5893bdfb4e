"""The agent node: M UAVs as rows of one process. It senses, listens, learns, acts and speaks, once a tick."""

import numpy as np
from numpy.typing import NDArray

from agent.byzantine import Byzantine
from agent.feedback import Feedback
from agent.heads import Heads
from agent.heard import Heard
from agent.learner import Learner, StepResult
from agent.offline import Program
from swarm import faults, model, payload, state
from swarm.codec import FLOAT_OF_BITS, expect, finite
from swarm.errors import MessageRejected
from swarm.messages import OUTCOME_FLOATS, Act, FrameKind, Frames, Sense, Welcome
from swarm.methods import Method
from swarm.model import BEYOND_SENSE
from swarm.rounds import Rounds
from swarm.scenario import Scenario, decode

Floats = NDArray[np.float64]

_STATE = np.dtype(np.float64)


class Agent:
    """What a node does with a Sense; whoever carries the messages calls `act`."""

    def __init__(self, welcome: Welcome) -> None:
        self.uavs = np.array(welcome.uavs, dtype=np.intp)
        self._names = self.uavs.astype(np.int32)  # as frames have them
        self._scenario: Scenario = decode(welcome.scenario)
        self._method = self._scenario.method
        self._float = FLOAT_OF_BITS[self._scenario.radio.bits_per_float]
        self._rounds = Rounds(self._scenario, self.uavs)
        self._rounds.draw_ahead()
        self._shared = model.shared(self._method)
        self._byzantine = Byzantine(self._scenario)
        self._heads = Heads(self._scenario, self.uavs)
        self._up, self._down = payload.upload(self._scenario), payload.broadcast(self._scenario)
        self._feedback = Feedback(self._up, len(self.uavs), kept=self._scenario.keeps_residuals)
        if self._feedback.residuals is not None and welcome.residuals is not None:
            kept = self._feedback.residuals
            kept[...] = expect("residuals", welcome.residuals, kept.shape, np.float64)
        plan = expect("initial_states", welcome.initial_states, (self._scenario.uavs, state.SIZE), self._float)
        plan = plan.astype(np.float64)
        self._learner = Learner(self._scenario)
        self._weights = self._learner.init(len(self.uavs), plan)
        if welcome.models is not None:  # a run that is resumed: the learners go on where they were
            self._weights[...] = expect("models", welcome.models, self._weights.shape, np.float64)
        self._program = Program(self._scenario, plan[self.uavs]) if self._method is Method.OFFLINE else None
        self._diverged = np.zeros(len(self.uavs), dtype=bool)
        self._silenced = False  # whether any has
        self._shape = (len(self.uavs), state.SIZE)
        self._own = np.zeros(self._scenario.uavs, dtype=bool)
        self._own[self.uavs] = True
        # What each row knows of everyone's state: the mission plan, then whatever its radio brings.
        self._known: Floats | None = None
        self._heard = Heard(self.uavs, self._scenario.uavs)
        if self._scenario.keeps_states:
            self._known = np.repeat(plan[None], len(self.uavs), axis=0)
            if welcome.known is not None:
                self._known[...] = expect("known", welcome.known, self._known.shape, np.float64)

    @property
    def _uploads_as_they_are(self) -> bool:
        """Whether nothing is kept of an upload, and nobody falsifies it."""
        return self._feedback.residuals is None and not len(self._byzantine.uavs)

    def act(self, sense: Sense) -> Act:
        """One tick.

        Raises:
            MessageRejected: the Sense does not fit this node; nothing has changed.
        """
        states = expect("states", sense.states, self._shape, _STATE)
        for frames in sense.inbox:
            self._check(frames)

        # 0. Rows the fault script pauses are as they were when the tick is over, whatever the others do.
        asleep = self._asleep(sense.tick)
        before = self._weights, self._known[asleep] if asleep is not None and self._known is not None else None
        # 1. Take in what the radio brought: a global model overwrites, a neighbour's state replaces the last one,
        #    and the head of a cluster keeps the uploads of a round.
        for frames in sense.inbox:
            self._receive(frames)
        # 2. Speak: in a round's tick the participants' models as they are now, and states where the method shares them;
        #    the means of clusters once all their uploads have come or are lost.
        relays, refused = self._relays(sense.tick, asleep)
        outbox = tuple(self._uploads(sense.tick, asleep) + relays + self._state_broadcasts(sense.tick, states))
        # 3. Learn one step of each network, and act on it.
        if self._known is not None:
            self._known[np.arange(len(self.uavs)), self.uavs] = states
        self._weights, numbers, largest = self._think(sense.tick, states)
        # 4. A learner that has left all bounds is reported and silenced; the other rows go on.
        if asleep is not None:
            numbers[asleep] = 0.0
            self._wake(asleep, *before)
        if self._silenced or not largest < BEYOND_SENSE:  # NaN is below nothing
            self._silence(~np.all(np.abs(numbers) < BEYOND_SENSE, axis=-1), numbers)
        return Act(
            run=sense.run,
            tick=sense.tick,
            outcome=numbers,
            diverged=tuple(self.uavs[self._diverged].tolist()) if self._silenced else (),
            outbox=outbox,
            report=self._weights if sense.report else None,
            known=self._known if sense.checkpoint else None,
            refused=tuple(refused),
            residuals=self._feedback.residuals if sense.checkpoint else None,
        )

    def _asleep(self, tick: int) -> NDArray[np.bool_] | None:
        """Which rows the fault script pauses in this tick, (M,); None for none."""
        if not self._scenario.faults:
            return None
        asleep = np.isin(self.uavs, faults.paused(self._scenario.faults, tick, self._scenario.dt))
        return asleep if asleep.any() else None

    def _think(self, tick: int, states: Floats) -> StepResult:
        if self._program is None:
            return self._learner.step(self._weights, states, self._known)
        numbers = np.zeros((len(self.uavs), OUTCOME_FLOATS))
        numbers[:, : state.AXES] = self._program(tick)
        return StepResult(self._weights, numbers, float(np.abs(numbers).max(initial=0.0)))

    def _check(self, frames: Frames) -> None:
        """A batch this node can receive, or MessageRejected."""
        rows = len(expect("source", frames.source, (None,), np.int32))
        is_global = frames.kind == FrameKind.GLOBAL
        if frames.kind == FrameKind.RELAY or (is_global and not self._method.is_federated):
            raise MessageRejected("wrong-kind", f"{frames.kind.name} frames are not for an agent")
        if is_global:
            self._down.check(frames.payload, rows)
        elif frames.kind == FrameKind.STATE:
            expect("payload", frames.payload, (rows, state.SIZE), self._float)
        if frames.links is None:
            raise MessageRejected("wrong-shape", "frames without links")
        links = expect("links", frames.links, (None, 2), np.int32)
        if frames.kind == FrameKind.STATE and self._heard.again(frames):
            return
        everyone = self._scenario.uavs
        if not (_within(frames.source, everyone) and _within(links[:, 1], everyone) and self._own[links[:, 1]].all()):
            raise MessageRejected("wrong-shape", "frames name UAVs that are not here")
        if not _within(links[:, 0], rows):
            raise MessageRejected("wrong-shape", "links beyond the payload")
        if frames.kind == FrameKind.UPLOAD:
            self._heads.check(frames)

    def _receive(self, frames: Frames) -> None:
        assert frames.links is not None
        if frames.kind == FrameKind.GLOBAL:
            sent, row = frames.links[:, 0], np.searchsorted(self.uavs, frames.links[:, 1])
            self._weights = self._weights.copy()
            self._weights[row, self._shared] = self._down.decode(frames.payload[sent])
        elif frames.kind == FrameKind.UPLOAD:
            self._heads.collect(frames)
        elif self._known is not None:
            self._heard.take_in(frames, self._known)
            if self._method.learns_density:  # only the rows that heard something: another row is another UAV
                hearing = np.unique(np.searchsorted(self.uavs, frames.links[:, 1]))
                refitted = self._learner.refit(self._weights[hearing], self._known[hearing])
                self._weights = self._weights.copy()
                self._weights[hearing] = refitted

    def _uploads(self, tick: int, asleep: NDArray[np.bool_] | None) -> list[Frames]:
        number = self._rounds.opens(tick)
        if not number:
            return []
        rows = self._rounds.rows(number)
        if asleep is not None or self._silenced:
            silent = self._diverged if asleep is None else self._diverged | asleep
            rows = rows[~silent[rows]]
        if not len(rows):
            return []
        source, models = self._names[rows], self._weights[rows, self._shared]
        if self._uploads_as_they_are:
            sent = self._up.encode_all(models)  # the short way
            if sent is not None:
                return [Frames(FrameKind.UPLOAD, number, source, sent)]
        sent = self._byzantine.distort(number, source, self._feedback.encode(rows, models), self._up)
        fits = self._up.sound(sent)  # a model beyond the range of the payload cannot be sent
        return [Frames(FrameKind.UPLOAD, number, source[fits], sent[fits])] if fits.any() else []

    def _relays(self, tick: int, asleep: NDArray[np.bool_] | None) -> tuple[list[Frames], list[int]]:
        if not self._rounds.relays(tick):
            return [], []
        return self._heads.relay(tick, self.uavs[self._diverged if asleep is None else self._diverged | asleep])

    def _state_broadcasts(self, tick: int, states: Floats) -> list[Frames]:
        period = 1 if self._method is Method.HJB else self._scenario.federation.state_period
        if self._program is not None or not period or tick % period or tick == 0:  # at 0 the mission plan has said it
            return []
        said = self._broadcast(states)
        if not self._silenced and finite(said):
            return [Frames(FrameKind.STATE, 0, self._names, said)]
        speaks = ~self._diverged & np.isfinite(said).all(axis=-1)
        return [Frames(FrameKind.STATE, 0, self._names[speaks], said[speaks])] if speaks.any() else []

    def _broadcast(self, states: Floats) -> NDArray[np.floating]:
        """States (M, 4) as they are broadcast; infinite where the radio's floats end."""
        with np.errstate(over="ignore"):
            return states.astype(self._float)

    def _wake(self, asleep: NDArray[np.bool_], weights: Floats, known: Floats | None) -> None:
        """Puts back what the sleeping rows had learned."""
        self._weights = np.where(asleep[:, None], weights, self._weights)
        if self._known is not None and known is not None:
            self._known[asleep] = known

    def _silence(self, broken: NDArray[np.bool_], numbers: Floats) -> None:
        """Zeros what diverged rows know and say, so that nothing non-finite ever leaves or spreads."""
        self._diverged |= broken
        self._silenced = bool(self._diverged.any())
        numbers[self._diverged] = 0.0
        self._weights = np.where(self._diverged[:, None], 0.0, self._weights)


def _within(numbers: NDArray[np.int32], end: int) -> bool:
    """Whether all of them are 0…end − 1."""
    return bool((numbers.astype(np.uint32) < end).all())  # what is negative is very large
