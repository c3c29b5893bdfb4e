"""Party: the part that one node, an agent or the leader, has in the rounds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.averager import Averager, RuleFailed
from meanflock.federation.byzantine import Byzantine
from meanflock.federation.exchange import Exchange
from meanflock.federation.mail import RECEIPT, Collector
from meanflock.federation.memory import Feedback, GlobalModels, NodeModels, Trigger
from meanflock.federation.plan import Plan
from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.base import Hop, Role
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.state import Floats, contains
from meanflock.swarm.wire.control import decode_record, expect
from meanflock.swarm.wire.messages import NOBODY, Frames

_RESIDUALS, _SENT = "meanflock.residuals", "meanflock.sent"  # in a checkpoint, next to the arrays of the controller


class Party:
    """A node's part in the rounds: it sends models, averages those of others, and takes averages over.

    Attributes:
        problems: texts for the world, appended.
        rule_record: the state of the aggregation rule after this tick's round, as a record; empty where none closed.
    """

    def __init__(
        self,
        plan: Plan,
        role: Role,
        uavs: NDArray[np.intp],
        problems: list[str],
        learner: NodeModels | None = None,
    ) -> None:
        """`uavs`: (M,) ascending, the rows of an agent; of the leader none.

        Raises:
            BadInput: the aggregation rule cannot begin.
        """
        self._uavs = uavs
        self._learner = learner
        self.problems = problems
        self._schedule = schedule = Schedule(plan, uavs)
        schedule.draw_ahead()
        self.rule_record = b""
        hops = schedule.hops
        self._own = [hop for hop in hops if hop.role == role]
        self._averagers = [
            Averager(hop, schedule, plan, here)
            for hop in self._own
            if hop.mail is not None and not hop.is_local and len(here := self._here(hop))
        ]
        local = next((hop for hop in self._own if hop.is_local), None)
        self._exchange = None if local is None else Exchange(local, plan, uavs, problems)
        self._collectors: list[Collector] = [*self._averagers, *([self._exchange] if self._exchange else [])]
        self._last = next((hop for hop in hops if hop.is_last), None) if role == "agent" else None
        self._globals: GlobalModels | None = None
        if self._last is not None and self._last.coding.fragments is not None and not self._last.is_local:
            self._globals = GlobalModels(self._last.coding, len(uavs))
        self._byzantine = Byzantine(plan.scenario)
        first = next((hop for hop in self._own if hop.mail is None), None)
        self._feedback = None if first is None else Feedback(first.coding, len(uavs), active=plan.keeps_residuals)
        threshold, parameters = plan.scenario.federation.upload_threshold, plan.declared.parameters
        self._trigger = Trigger(threshold, len(uavs), parameters) if first is not None and threshold else None

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
            hops[0].coding.check_received(frames.source, frames.payload)
        if not any(hop.reaches(frames.source[sent], to).all() for hop in hops):
            raise MessageRejected("wrong-shape", f"{frames.kind.name} frames to UAVs that do not receive them")

    def receive(self, frames: Frames, tick: int) -> None:
        """Takes frames that `check` let through: collects mail, and hands the model of a last hop to the learner."""
        hop = self._schedule.sent(frames.kind, frames.round, tick)
        if hop is None:
            return
        for collector in self._collectors:
            if collector.hop.mail is hop:
                collector.collect(frames)
        if hop is self._last:
            assert self._learner is not None
            assert frames.links is not None
            sent, row = frames.links[:, 0].astype(np.intp), self._uavs.searchsorted(frames.links[:, 1])
            if self._globals is None:
                self._learner.take(row, hop.coding.decode(frames.payload[sent]))
            else:
                self._globals.add(sent, row, hop.coding.received(frames.payload))

    def act(self, tick: int) -> tuple[list[Frames], list[int]]:
        """The part of a tick: the frames that this node's UAVs transmit, and the UAVs whose models they refuse.

        Where the last hop is local, the learner takes the averages of its rows.
        """
        self.rule_record = b""
        outbox: list[Frames] = []
        refused: list[int] = []
        if not self._schedule.is_busy(tick):
            return outbox, refused
        if self._globals is not None and self._schedule.ends(tick):
            assert self._learner is not None
            self._globals.take(self._learner)
        for hop in self._own:
            if hop.mail is None and (number := self._schedule.number(hop, tick)):
                outbox += self._uploads(hop, number)
        for averager in self._averagers:
            if number := self._schedule.number(averager.hop, tick):
                outbox += self._averages(averager, number, refused)
        if self._exchange is not None and (number := self._schedule.number(self._exchange.hop, tick)):
            refused += self._take_own(self._exchange, number)
        return outbox, refused

    def state(self) -> dict[str, NDArray[Any]]:
        """Arrays of M rows that a checkpoint keeps, and that `restore` writes to."""
        residuals = None if self._feedback is None else self._feedback.residuals
        state = {} if residuals is None else {_RESIDUALS: residuals}
        if self._trigger is not None:
            state[_SENT] = self._trigger.sent
        if self._globals is not None:
            state |= self._globals.state()
        return state if self._exchange is None else state | self._exchange.state()

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Takes the arrays of `state` out of those of a checkpoint, which loses them.

        Raises:
            MessageRejected: they do not fit.
        """
        for name, array in self.state().items():
            array[...] = expect(name, state.pop(name, NOBODY), array.shape, array.dtype)

    def take_over(self, record: bytes) -> None:
        """Goes on with the state of the aggregation rule that another leader left, a record."""
        state = decode_record(record)
        for averager in self._averagers:
            if averager.hop.ruled:
                averager.take_over(state)

    def _here(self, hop: Hop) -> NDArray[np.intp]:
        """The UAVs of this node that send in a hop."""
        return hop.senders if hop.role == "leader" else self._uavs[contains(hop.senders, self._uavs)]

    def _receives(self, hop: Hop) -> bool:
        return hop is self._last or any(collector.hop.mail is hop for collector in self._collectors)

    def _uploads(self, hop: Hop, number: int) -> list[Frames]:
        """The models of the rows that take part in a round."""
        assert self._learner is not None
        assert self._feedback is not None
        coding, participants = hop.coding, self._learner.ready(self._schedule.rows(number))
        rows, models, weights = self._learner.models_to_send(
            participants if self._exchange is None else np.arange(len(self._uavs))
        )
        if self._exchange is not None:
            self._exchange.remember(number, rows, coding.pack(coding.encode(models), weights[:, None]))
            takes_part = contains(participants, rows)
            rows = rows[takes_part]
            models = models[takes_part]
            weights = weights[takes_part]
        if self._trigger is not None and len(rows):
            due = self._trigger.due(rows, models)
            rows = rows[due]
            models = models[due]
            weights = weights[due]
        if not len(rows):
            return []
        source = self._uavs[rows].astype(np.int32)
        numbers = self._feedback.encode(rows, models)
        if self._exchange is not None:
            self._exchange.remember(number, rows, coding.pack(numbers, weights[:, None]))
        numbers = self._byzantine.distort(number, source, numbers, coding)
        return _valid(hop, number, source, coding.pack(numbers, weights[:, None]))

    def _take_own(self, exchange: Exchange, number: int) -> list[int]:
        """Lets the learner take the averages of its rows; returns the UAVs whose models they refuse to average."""
        assert self._learner is not None
        rows, models, refused = exchange.average(number, ~self._learner.silent())
        if len(rows):
            self._learner.take(rows, models)
        return refused

    def _averages(self, averager: Averager, number: int, refused: list[int]) -> list[Frames]:
        """The averages of the UAVs of this node that send in a hop; a UAV with nothing to average sends nothing."""
        hop, found = averager.hop, dict[int, tuple[Floats, Floats, Floats]]()
        joined = averager.close(number)
        refused += joined.refused
        for uav in self._speakers(averager):
            try:
                model, weights, behind = averager.average(joined, number, uav)
            except RuleFailed as error:
                self.problems.append(str(error))
                continue
            if model is not None:
                found[uav] = model, weights, behind
        if averager.hop.ruled:
            self.rule_record = averager.record
        if not found:
            return []
        payload = hop.coding.write(*(np.stack(tables) for tables in zip(*found.values(), strict=True)))
        frames = _valid(hop, number, np.array(list(found), dtype=np.int32), payload)
        if not frames and hop.role == "leader":
            largest = max(float(np.abs(model).max()) for model, *_ in found.values())
            self.problems.append(
                f"round {number}: the global model has {largest:g}, beyond what the radio's floats can say"
            )
        return frames

    def _speakers(self, averager: Averager) -> list[int]:
        """The UAVs of an averager that are not silent now, ascending."""
        if self._learner is None:
            return averager.uavs.tolist()
        return averager.uavs[~contains(self._uavs[self._learner.silent()], averager.uavs)].tolist()


def _valid(hop: Hop, number: int, source: NDArray[np.int32], payload: np.ndarray) -> list[Frames]:
    """Frames of a hop, without models that are beyond the range of the coding."""
    fits = hop.coding.valid(hop.coding.unpack(payload)[0])
    if not fits.all():
        source = source[fits]
        payload = payload[fits]
    return [Frames(hop.label, number, source, payload)] if len(source) else []


def _check_receipt(frames: Frames) -> None:
    """Validates the slots that models were on the air.

    Raises:
        MessageRejected: `wrong-shape`.
    """
    expect("receipt", frames.payload, (len(frames.source), 1), RECEIPT)
    if (frames.payload < 0).any():
        raise MessageRejected("wrong-shape", "receipt: negative numbers of slots")
