"""The agent node: M UAVs as rows of one process. It senses, listens, learns, acts and speaks, once a tick."""

import numpy as np
from numpy.typing import NDArray

from agent.byzantine import Byzantine
from agent.chorus import Chorus
from agent.feedback import Feedback
from agent.heads import Heads
from agent.heard import Heard
from agent.kernel import Answer
from agent.learner import Learner
from agent.minds import Minds, Outcome
from agent.offline import Program
from agent.reflex import Reflex
from swarm import faults, model, payload, state
from swarm.codec import FLOAT_OF_BITS, expect, finite
from swarm.errors import MessageRejected
from swarm.messages import Act, FrameKind, Frames, Sense, Welcome
from swarm.methods import Method
from swarm.model import BEYOND_SENSE
from swarm.rounds import NEVER, Rounds
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
        ahead = self._rounds.draw_ahead()
        self._reflex: Reflex | None = None  # where some ticks come to nothing but to learn: then it has the minds
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
        self._minds = self._learner.init(len(self.uavs), plan)
        if welcome.models is not None:  # a run that is resumed: the minds go on where they were
            models = expect("models", welcome.models, (len(self.uavs), model.MODEL_FLOATS), np.float64)
            self._minds = self._minds.with_models(np.arange(len(self.uavs)), slice(None), models)
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
        sleeps = any(isinstance(fault, faults.Pause) for fault in self._scenario.faults)
        self._alike = NEVER  # ticks that are answered like this
        self._answer: Answer
        self._round = 0
        self._places = b""  # of the rows that upload
        kernel = self._learner.kernel
        if kernel is not None and self._known is None and self._program is None and not sleeps:
            told = welcome.run, self.uavs, self._rounds, ahead, self._minds
            self._reflex = Reflex(kernel, self._scenario, *told, uploads=self._uploads_as_they_are)
        self._chorus: Chorus | None = None
        if self._method is Method.HJB and not sleeps and Chorus.serves(len(self.uavs), self._scenario.uavs):
            self._chorus = Chorus(self._scenario, welcome.run, self.uavs, self._float)

    def reflex(self, raw: bytes, tick: int) -> bytes | None:
        """Answers a plain Sense of that tick where nothing is to be done but to learn, to upload the models, to take
        over the global one, or to hear everyone's state and say one's own; otherwise None."""
        if tick not in self._alike and not self._looks_ahead(tick):
            return None if self._chorus is None or self._silenced else self._join_in(self._chorus, raw, tick)
        return self._answer(raw, tick, self._round, self._places)

    def _looks_ahead(self, tick: int) -> bool:
        """Whether there is an answer by reflex in that tick, which then may be that of some ticks."""
        if self._reflex is None or self._silenced or (found := self._reflex.at(tick)) is None:
            return False
        self._alike, self._answer, self._round, self._places = found
        return True

    def _join_in(self, chorus: Chorus, raw: bytes, tick: int) -> bytes | None:
        assert self._known is not None
        if (heard := chorus.hear(raw, tick, self._known)) is None:
            return None
        states, acts = heard
        said = self._broadcast(states)
        if not finite(said):
            return None
        outcome = self._think(tick, states)
        if not outcome.largest < BEYOND_SENSE:
            return None  # what is known is by now what it will be the long way
        self._minds = outcome.minds
        return chorus.answer(acts, tick, outcome.numbers, said, self._minds)

    @property
    def _minds(self) -> Minds:
        return self._learned if self._reflex is None else self._reflex.minds

    @_minds.setter
    def _minds(self, minds: Minds) -> None:
        if self._reflex is None:
            self._learned = minds
        else:
            self._reflex.learn(minds)

    @property
    def _uploads_as_they_are(self) -> bool:
        """Whether nothing is kept of an upload, and nobody falsifies it."""
        return self._feedback.residuals is None and not len(self._byzantine.uavs)

    @property
    def models(self) -> Floats:
        """What each row has learned so far, `(M, 246)`."""
        return self._minds.models()

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
        before = self._minds, self._known[asleep] if asleep is not None and self._known is not None else None
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
        outcome = self._think(sense.tick, states)
        self._minds, numbers = outcome.minds, outcome.numbers
        # 4. A learner that has left all bounds is reported and silenced; the other rows go on.
        if asleep is not None:
            numbers[asleep] = 0.0
            self._wake(asleep, *before)
        if self._silenced or not outcome.largest < BEYOND_SENSE:  # NaN is below nothing
            self._silence(~np.all(np.abs(numbers) < BEYOND_SENSE, axis=-1), numbers)
        return Act(
            run=sense.run,
            tick=sense.tick,
            outcome=numbers,
            diverged=tuple(self.uavs[self._diverged].tolist()) if self._silenced else (),
            outbox=outbox,
            report=self._minds.models() if sense.report else None,
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

    def _think(self, tick: int, states: Floats) -> Outcome:
        if self._program is None:
            return self._learner.step(self._minds, states, self._known)
        return Outcome.of(self._minds, self._program(tick))

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
            self._minds = self._minds.with_models(row, self._shared, self._down.decode(frames.payload[sent]))
        elif frames.kind == FrameKind.UPLOAD:
            self._heads.collect(frames)
        elif self._known is not None:
            self._heard.take_in(frames, self._known)
            if self._method.learns_density:  # only the rows that heard something: another row is another UAV
                hearing = np.unique(np.searchsorted(self.uavs, frames.links[:, 1]))
                heard = Minds(self._minds.value[hearing], self._minds.density[hearing])
                density = self._minds.density.copy()
                density[hearing] = self._learner.refit(heard, self._known[hearing]).density
                self._minds = Minds(self._minds.value, density)

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
        source, models = self._names[rows], self._minds.models()[rows, self._shared]
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

    def _wake(self, asleep: NDArray[np.bool_], minds: Minds, known: Floats | None) -> None:
        """Puts back what the sleeping rows had in mind."""
        kept = asleep[:, None, None]
        value = np.where(kept, minds.value, self._minds.value)
        self._minds = Minds(value, np.where(kept, minds.density, self._minds.density))
        if self._known is not None and known is not None:
            self._known[asleep] = known

    def _silence(self, broken: NDArray[np.bool_], numbers: Floats) -> None:
        """Zeros what diverged rows know and say, so that nothing non-finite ever leaves or spreads."""
        self._diverged |= broken
        self._silenced, self._alike = bool(self._diverged.any()), NEVER
        numbers[self._diverged] = 0.0
        keep = ~self._diverged[:, None, None]
        self._minds = Minds(np.where(keep, self._minds.value, 0.0), np.where(keep, self._minds.density, 0.0))


def _within(numbers: NDArray[np.int32], end: int) -> bool:
    """Whether all of them are 0…end − 1."""
    return bool((numbers.astype(np.uint32) < end).all())  # what is negative is very large
