"""Rounds: the part that one node, an agent or the leader, has in the rounds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.averager import Averager, Averages
from meanflock.federation.byzantine import Byzantine
from meanflock.federation.inbox import RECEIPT
from meanflock.federation.memory import Feedback, GlobalModels, NodeModels, OwnModels, Sent
from meanflock.federation.plan import Plan
from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.base import Hop, Role
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.events.nodes import FailedAverage, Problem
from meanflock.swarm.state import Mask, contains
from meanflock.swarm.wire.control import expect
from meanflock.swarm.wire.messages import NOBODY, Frames

_RESIDUALS, _SENT = "meanflock.residuals", "meanflock.sent"  # in a checkpoint, next to the arrays of the controller
_COPIES, _COPIED, _SAMPLES = "meanflock.copies", "meanflock.copied", "meanflock.samples"


class Rounds:
    """A node's part in the rounds: it sends models, averages those of others, and takes averages over.

    Attributes:
        problems: reports to the world, appended.
        rule_record: the state of the aggregation rule after this tick's round, as a record; empty where none closed.
        waiting: UAVs at which the aggregation rule waits for more models after this tick's round.
    """

    def __init__(
        self,
        plan: Plan,
        role: Role,
        uavs: NDArray[np.intp],
        problems: list[Problem],
        models: NodeModels | None = None,
    ) -> None:
        """`uavs`: (M,) ascending, the rows of an agent; of the leader none. `models`: those of the rows.

        Raises:
            BadInput: the aggregation rule cannot begin.
        """
        self._plan, self._uavs = plan, uavs
        self._models = models
        self.problems = problems
        self.rule_record = b""
        self.waiting: list[int] = []
        self._schedule = schedule = Schedule(plan, uavs)
        schedule.draw_ahead()
        takes_part = role == "leader" or bool(contains(plan.scenario.members, uavs).all())
        hops = schedule.hops if takes_part else ()
        self._own = [hop for hop in hops if hop.role == role]
        # Also of an agent without a head of a cluster: checkpoints have the same arrays of all agents.
        self._averagers = [
            Averager(hop, schedule, plan, hop.senders if role == "leader" else uavs[contains(hop.senders, uavs)], uavs)
            for hop in self._own
            if hop.mail is not None
        ]
        self._byzantine = Byzantine(plan.scenario)
        federation = plan.scenario.federation
        self._first = next((hop for hop in self._own if hop.mail is None), None)
        self._feedback: Feedback | None = None
        self._sent: Sent | None = None
        self._copies: OwnModels | None = None  # where a hop is local
        if self._first is not None:
            codec = self._first.codec
            self._feedback = Feedback(codec, uavs, active=plan.keeps_residuals)
            if federation.upload_threshold or federation.share < 1.0:
                self._sent = Sent(codec, len(uavs), federation.upload_threshold, federation.share)
            if any(hop.is_local for hop in self._own):
                self._copies = OwnModels(codec, len(uavs))
        self._last = next((hop for hop in hops if hop.is_last), None) if role == "agent" else None
        self._globals: GlobalModels | None = None
        if self._last is not None and not self._last.is_local:
            self._globals = GlobalModels(self._last.codec, len(uavs), gathers=schedule.gathers)

    def check(self, frames: Frames) -> None:
        """Validates frames of a round that the world delivers; the reader has checked that they name UAVs of the swarm.

        Raises:
            MessageRejected: `wrong-kind`, `wrong-shape` or `non-finite`; nothing has changed.
        """
        hops = [hop for hop in self._schedule.hops if hop.label == frames.kind and self._receives(hop)]
        if not hops:
            raise MessageRejected("wrong-kind", f"{frames.kind.name} frames are not for this node")
        if frames.links is None:
            raise MessageRejected("wrong-shape", "frames without links")
        sent, to = frames.links[:, 0], frames.links[:, 1]
        if not contains(hops[0].senders, frames.source).all():
            raise MessageRejected("wrong-shape", f"{frames.kind.name} frames of UAVs {frames.source.tolist()}")
        if frames.payload.dtype == RECEIPT and hops[0] is not self._last:
            _check_receipt(frames)
        else:
            hops[0].codec.check(frames.source, frames.payload, newest=hops[0].newest_base(frames.round))
        if not any(hop.reaches(frames.source[sent], to).all() for hop in hops):
            raise MessageRejected("wrong-shape", f"{frames.kind.name} frames to UAVs that do not receive them")

    def receive(self, frames: Frames, tick: int) -> None:
        """Takes frames that `check` let through: collects mail, and hands the model of a last hop to the rows."""
        hop = self._schedule.sent(frames.kind, frames.round, tick)
        if hop is None:
            return
        for averager in self._averagers:
            if averager.hop.mail is hop:
                averager.mail.add(frames)
        if hop is self._last and self._globals is not None:
            assert self._models is not None
            assert frames.links is not None
            sent, row = frames.links[:, 0].astype(np.intp), self._uavs.searchsorted(frames.links[:, 1])
            self._globals.add(sent, row, hop.codec.read(frames.payload), frames.round, self._models)

    def act(self, tick: int) -> tuple[list[Frames], list[int]]:
        """The part of a tick: the frames that this node's UAVs transmit, and the UAVs whose models they refuse.

        Where the last hop is local, the rows take the averages.
        """
        self.rule_record = b""
        self.waiting = []
        outbox: list[Frames] = []
        refused: list[int] = []
        if not self._schedule.is_busy(tick):
            return outbox, refused
        if self._globals is not None and self._globals.gathers and (number := self._schedule.ends(tick)):
            assert self._models is not None
            self._globals.take(number, self._models)
        if self._first is not None and (number := self._schedule.number(self._first, tick)):
            outbox += self._uploads(self._first, number)
        for averager in self._averagers:
            if number := self._schedule.number(averager.hop, tick):
                own = self._copies if averager.hop.is_local else None
                averages = averager.average(number, self._speaking(averager, number), own)
                refused += averages.refused
                self.waiting += averages.waiting
                for text, uavs in averages.failed.items():
                    self.problems.append(text if averager.hop.role == "leader" else FailedAverage(tuple(uavs), text))
                outbox += self._sent_averages(averager, number, averages)
                if averager.hop.role == "leader":
                    self.rule_record = averager.record
        return outbox, refused

    def state(self) -> dict[str, NDArray[Any]]:
        """Arrays of M rows that a checkpoint keeps, and that `restore` writes to."""
        state: dict[str, NDArray[Any]] = {}
        if self._feedback is not None and self._feedback.residuals is not None:
            state[_RESIDUALS] = self._feedback.residuals
        if self._sent is not None:
            state[_SENT] = self._sent.models
        if self._globals is not None:
            state |= self._globals.state()
        if self._copies is not None:
            state |= {_COPIES: self._copies.models, _COPIED: self._copies.rounds, _SAMPLES: self._copies.samples}
        for averager in self._averagers:
            state |= averager.state()
        return state

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Takes the arrays of `state` out of those of a checkpoint, which loses them.

        Raises:
            MessageRejected: they do not fit.
        """
        for name, array in self.state().items():
            array[...] = expect(name, state.pop(name, NOBODY), array.shape, array.dtype)

    def take_over(self, record: bytes) -> None:
        """Goes on with the state of the aggregation rule that another leader left, a record."""
        for averager in self._averagers:
            if averager.hop.averages == "models":
                averager.take_over(record)

    def _receives(self, hop: Hop) -> bool:
        return hop is self._last or any(averager.hop.mail is hop for averager in self._averagers)

    def _uploads(self, hop: Hop, number: int) -> list[Frames]:
        """The models of the rows that take part in a round."""
        assert self._models is not None
        assert self._feedback is not None
        codec = hop.codec
        wanted = self._models.ready(self._schedule.rows(number))
        rows, models, weights = self._models.models_to_send(
            wanted if self._copies is None else np.arange(len(self._uavs))
        )
        if self._copies is not None:
            self._copies.put(number, rows, codec.encode(models, self._uavs[rows], number), weights)
            takes_part = contains(wanted, rows)
            rows, models, weights = rows[takes_part], models[takes_part], weights[takes_part]
        chosen = None
        if self._sent is not None and len(rows):
            chosen = self._sent.due(rows, models)
            due = chosen.any(axis=1)
            rows, models, weights, chosen = rows[due], models[due], weights[due], chosen[due]
        if not len(rows):
            return []
        source = self._uavs[rows].astype(np.int32)
        coded = self._feedback.encode(rows, models, number, chosen)
        if self._copies is not None:
            self._copies.put(number, rows, coded, weights)
        coded = self._byzantine.distort(number, source, coded, codec)
        fits = codec.valid(coded)
        heads = None
        if codec.form.head:
            based = self._models.based(rows)
            newest = hop.newest_base(number)
            based = np.full(len(rows), newest) if based is None else np.clip(based, 0, newest)
            heads = codec.heads(based, self._models.notes(rows))
        return _frames(hop, number, source, codec.rows(coded, weights[:, None], None, heads), fits, chosen)

    def _sent_averages(self, averager: Averager, number: int, averages: Averages) -> list[Frames]:
        """The averages as frames; the rows take those of a hop that is local."""
        hop, codec, (rows, models, weights, behind, notes, *_) = averager.hop, averager.hop.codec, averages
        if not len(rows):
            return []
        if hop.is_local:
            assert self._models is not None
            self._models.take(rows, models, number, np.ones(len(rows), dtype=bool), (b"",) * len(rows))
            return []
        source = averager.uavs[rows].astype(np.int32)
        coded = codec.encode(models, source, number)
        fits = codec.valid(coded)
        counts = behind.astype(codec.held)
        if codec.form.counted:
            fits &= np.isfinite(counts).all(axis=1)
        heads = codec.heads(np.full(len(rows), number), notes)
        frames = _frames(hop, number, source, codec.rows(coded, weights, behind, heads), fits)
        if not frames and hop.role == "leader":
            largest = float(np.abs(models).max())
            self.problems.append(
                f"round {number}: the global model has {largest:g}, beyond what the radio's floats can say"
            )
        return frames

    def _speaking(self, averager: Averager, number: int) -> Mask:
        """Mask of the nodes that average a round: UAVs that are not silent now, or that of the leader."""
        if self._models is None:
            return contains(self._plan.senders(averager.hop, number), averager.uavs)
        return ~contains(self._uavs[self._models.silent()], averager.uavs)


def _frames(
    hop: Hop, number: int, source: NDArray[np.int32], rows: np.ndarray, fits: Mask, chosen: Mask | None = None
) -> list[Frames]:
    """Frames of a hop: the fragments (S·F, width) that are `chosen` (S, F), of models that the coding can hold (S,)."""
    count = hop.codec.count
    source = np.repeat(source, count)
    taken = np.repeat(fits, count)
    if chosen is not None:
        taken &= chosen.reshape(-1)
    if not taken.all():
        source, rows = source[taken], rows[taken]
    return [Frames(hop.label, number, source, rows)] if len(source) else []


def _check_receipt(frames: Frames) -> None:
    """Validates the slots that models were on the air.

    Raises:
        MessageRejected: `wrong-shape`.
    """
    expect("receipt", frames.payload, (len(frames.source), 1), RECEIPT)
    if (frames.payload < 0).any():
        raise MessageRejected("wrong-shape", "receipt: negative numbers of slots")
