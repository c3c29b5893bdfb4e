"""Averager: makes one model of those of a round, on whatever node averages.

Sums go by ascending UAV, a UAV's own model last, so that neither the order of arrival nor other rows leave a trace.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.federation.inbox import Round
from meanflock.federation.memory import OwnModels
from meanflock.federation.plan import Plan
from meanflock.federation.rule import Rule, RuleFailed
from meanflock.federation.rules.base import Aggregate, State
from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.base import Hop
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.state import Floats, Mask, contains
from meanflock.swarm.wire.control import decode_record, encode_record

Indices = NDArray[np.intp]
VERDICT = "meanflock.verdict"  # in the record of a rule
_RULE = "meanflock.rule."  # in a checkpoint


class RuleVerdict(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What an aggregation rule said of a round beside its model; see `rules.base.Aggregate`."""

    is_done: bool = False
    metrics: dict[str, float] = {}


class Averages(NamedTuple):
    """The averages of a round.

    rows: (R,) places of the UAVs that have one. models: (R, L). weights, behind: (R, F), sum of the weights of the
    models behind each fragment, and their number. notes: (R,) bytes beside them. refused: UAVs whose models cannot be
    averaged, ascending. failed: UAVs at which the rule failed, by the text about it. waiting: UAVs at which it waits
    for more models.
    """

    rows: Indices
    models: Floats
    weights: Floats
    behind: Floats
    notes: tuple[bytes, ...]
    refused: list[int]
    failed: dict[str, list[int]]
    waiting: list[int]


class Averager:
    """The mail of the UAVs of a node that average for one hop, and the state of the aggregation rule in each.

    Attributes:
        hop: the hop. mail: what has arrived, of all rounds.
        uavs: (A,) the UAVs of this node that average, ascending.
    """

    def __init__(self, hop: Hop, schedule: Schedule, plan: Plan, uavs: Indices, node: Indices) -> None:
        """`node`: (M,) the UAVs of the node; of the leader none.

        Raises:
            BadInput: the aggregation rule cannot begin.
        """
        assert hop.mail is not None
        self.hop, self.uavs = hop, uavs
        self.mail = Round(0, hop.mail.codec, uavs)
        self._takes_late = plan.scenario.federation.deadline is not None
        self._schedule = schedule
        self._floats = plan.declared.parameters
        self._rule = Rule(plan) if hop.averages == "models" else None
        state = {} if self._rule is None else self._rule.begin()
        if self._rule is not None and hop.role != "leader" and (self._rule.state_bytes or not self._rule.resumable):
            fault = "whose length changes" if self._rule.state_bytes else "that is not in checkpoints"
            raise BadInput(
                f"`federation.aggregation` {plan.scenario.federation.aggregation} has a state {fault}, which a leader "
                "keeps, and no other UAV; set `federation.topology` to leader"
            )
        self._places = node.searchsorted(uavs) if len(node) else np.zeros(len(uavs), dtype=np.intp)
        self._states: dict[str, Any] = {  # by place; only the leader's may change their lengths
            name: np.repeat(array[None], len(node), axis=0) if len(node) else [array] for name, array in state.items()
        }
        self._is_done = False
        self._metrics: Mapping[str, float] = {}  # of the last round

    @property
    def record(self) -> bytes:
        """The state of the aggregation rule in the leader, a record; empty where it has none."""
        state = {name: arrays[0] for name, arrays in self._states.items()}
        if self._is_done or self._metrics:
            verdict = msgspec.msgpack.encode(RuleVerdict(self._is_done, dict(self._metrics)))
            state[VERDICT] = np.frombuffer(verdict, dtype=np.uint8)
        return encode_record(state) if state else b""

    def take_over(self, record: bytes) -> None:
        """Goes on with the state of the aggregation rule that another leader left, a record."""
        state = decode_record(record)
        self._is_done = verdict_of(record).is_done
        state.pop(VERDICT, None)
        self._states = {name: [array] for name, array in state.items()}

    def state(self) -> dict[str, NDArray[Any]]:
        """Arrays of M rows that a checkpoint keeps, and that may be written to."""
        return {_RULE + name: array for name, array in self._states.items()}

    def average(self, number: int, speaking: Mask, own: OwnModels | None = None) -> Averages:
        """The averages of a round at the UAVs that are `speaking` (A,); its mail is forgotten.

        A UAV that received nothing has none; nor has one in the last hop that received its own model only.

        Args:
            own: their own models, where these are not in the mail.
        """
        round_ = self.mail.take(number, late=self._takes_late)
        round_.own = own
        rows = np.flatnonzero(speaking & self._due(round_))
        failed: dict[str, list[int]] = {}
        waiting: list[int] = []
        found: list[tuple[int, Floats, bytes]] = []
        try:
            models = self._weighted(round_, rows) if len(rows) and not self._is_done else None
        except RuleFailed as error:
            failed[str(error)] = self.uavs[rows].tolist()
            rows, models = rows[:0], None
        if models is not None:
            found = [(row, model, b"") for row, model in zip(rows.tolist(), models, strict=True)]
        elif not self._is_done:
            for row in rows.tolist():
                try:
                    aggregate = self._one(round_, row)
                except RuleFailed as error:  # this row keeps its model, and its state of the rule
                    failed.setdefault(str(error), []).append(int(self.uavs[row]))
                    self._is_done = not self._rule.resumable if self._rule else False
                    continue
                if aggregate.model is None:
                    waiting.append(int(self.uavs[row]))
                else:
                    found.append((row, aggregate.model, aggregate.note))
        rows = np.array([row for row, *_ in found], dtype=np.intp)
        tables = round_.stands_for(rows)
        stacked = np.array([model for _, model, _ in found]).reshape(-1, self._floats)
        notes = tuple(note for *_, note in found)
        return Averages(rows, stacked, *tables, notes, round_.refused, failed, waiting)

    def _due(self, round_: Round) -> Mask:
        """The UAVs (A,) that have something to average."""
        if self._rule is not None and self._rule.asked_void:
            return np.ones(len(self.uavs), dtype=bool)
        heard = round_.arrived.any(axis=(1, 2))
        if round_.own is not None:
            return np.asarray(heard & (round_.own.rounds == round_.number))
        if not self.hop.is_last:
            return np.asarray(heard)
        is_other = (round_.arrived.any(axis=2) & (round_.senders != self.uavs[:, None])).any(axis=1)
        if self.hop.averages == "means":
            behind = round_.stands_for(np.arange(len(self.uavs)))[1].max(axis=1)
            is_other |= behind > contains(self._schedule.participants(round_.number), self.uavs)
        return np.asarray(is_other)

    def _weighted(self, round_: Round, rows: Indices) -> Floats | None:
        """The averages (R, L) in some rows, if they are weighted means."""
        if self._rule is None:
            return round_.means(rows, round_.weights)
        if (weights := self._rule.weights(round_.all_uploads)) is None:
            return None
        own = None if round_.own is None else self._rule.weights(round_.own_uploads)
        return round_.means(rows, weights, own)

    def _one(self, round_: Round, row: int) -> Aggregate:
        """The average in one row by a rule that is no weighted mean."""
        assert self._rule is not None
        place = self._places[row]
        before: State = {name: arrays[place] for name, arrays in self._states.items()}
        after, aggregate = self._rule.step(before, round_.uploads(row))
        for name, array in after.items():
            self._states[name][place] = array
        self._is_done, self._metrics = aggregate.done and self.hop.role == "leader", aggregate.metrics
        return aggregate


def verdict_of(record: bytes) -> RuleVerdict:
    """What a rule said of a round, in the record that it left.

    Raises:
        MessageRejected: the record is malformed.
    """
    raw = decode_record(record).get(VERDICT) if record else None
    if raw is None:
        return RuleVerdict()
    try:
        return msgspec.msgpack.decode(raw.tobytes(), type=RuleVerdict)
    except msgspec.MsgspecError as error:
        raise MessageRejected("malformed", f"verdict of the aggregation rule: {error}") from error
