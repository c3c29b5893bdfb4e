"""Exchange: the UAVs of one node average what they receive with their own models, where no leader does it for them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.averager import Rule, RuleFailed, is_usable
from meanflock.federation.coding import Coding
from meanflock.federation.rules.base import Uploads
from meanflock.federation.topology.base import Hop
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask
from meanflock.swarm.wire.control import expect
from meanflock.swarm.wire.messages import NOBODY, Frames

_COPIES, _COPIED, _RULE = "meanflock.copies", "meanflock.copied", "meanflock.rule."  # in a checkpoint

Indices = NDArray[np.intp]


class Exchange:
    """Own models and mail of M UAVs, and the state that the aggregation rule has in each of them.

    Sums go by ascending UAV, the own model last: neither the order of arrival nor the other rows leave a trace.
    """

    def __init__(self, hop: Hop, scenario: Scenario, uavs: Indices, complaints: list[str]) -> None:
        """`hop`: the local one. `uavs`: (M,) ascending. `complaints`: what the rule fails with is appended.

        Raises:
            BadInput: the aggregation rule cannot begin.
        """
        assert hop.mail is not None
        self.hop, self._coding, self._uavs = hop, hop.mail.coding, uavs
        self._complaints = complaints
        self._rule = Rule(scenario)
        self._states = {name: np.repeat(array[None], len(uavs), axis=0) for name, array in self._rule.begin().items()}
        self._copies = np.zeros((len(uavs), self._coding.floats))  # (M, L) own models, as the coding leaves them
        self._copied = np.zeros(len(uavs), dtype=np.int64)  # (M,) the rounds of these copies
        self._mail: dict[int, list[Frames]] = {}  # by round
        self._takes_late = scenario.federation.deadline is not None

    def keep(self, number: int, rows: Indices, payload: np.ndarray) -> None:
        """Keeps the own models of rows (S,) for a round, as payloads (S, width), but for those that cannot be sent."""
        sound = self._coding.sound(payload)
        self._copies[rows[sound]] = self._coding.decode(payload[sound])
        self._copied[rows[sound]] = number

    def collect(self, frames: Frames) -> None:
        """Stores mail for the rows."""
        self._mail.setdefault(frames.round, []).append(frames)

    def average(self, number: int, awake: Mask) -> tuple[Indices, Floats, list[int]]:
        """The averages of a round; its mail is forgotten.

        Args:
            awake: (M,) the rows that average.

        Returns:
            The rows that have an average, (R,): not those that received nothing, or had no model when the round opened.
            Their averages (R, L). The UAVs whose models cannot be averaged, ascending.
        """
        late = self._mail.get(number - 1, []) if self._takes_late else []
        batches = late + self._mail.get(number, [])
        self._mail = {later: mail for later, mail in self._mail.items() if later > number}
        senders, sent, models, delivered = _merged(batches, self._coding, self._uavs)
        sound = is_usable(models)
        refused = np.unique(senders[~sound & delivered.any(axis=0)]).tolist()
        senders, sent, models, delivered = senders[sound], sent[sound], models[sound], delivered[:, sound]
        rows = np.flatnonzero(awake & (self._copied == number) & delivered.any(axis=1))
        if not len(rows):
            return rows, np.zeros((0, self._coding.floats)), refused
        received = Uploads(models, senders, sent, number)
        own = Uploads(self._copies[rows], self._uavs[rows], np.full(len(rows), number), number)
        try:
            weights, own_weights = self._rule.weights(received), self._rule.weights(own)
        except RuleFailed as error:
            self._complaints.append(str(error))
            return rows[:0], own.models[:0], refused
        if weights is not None and own_weights is not None:
            return rows, _weighted(received.models, weights, own.models, own_weights, delivered[rows]), refused
        taken, averages, failures = [], [], list[str]()
        for row, copy in zip(rows.tolist(), own.models, strict=True):
            try:
                average = self._one(row, copy, received, delivered[row])
            except RuleFailed as error:  # this row keeps its model, and its state of the rule
                failures.append(str(error))
                continue
            if average is not None:
                taken.append(row)
                averages.append(average)
        self._complaints += dict.fromkeys(failures)
        return np.array(taken, dtype=np.intp), np.array(averages).reshape(-1, self._coding.floats), refused

    def state(self) -> dict[str, NDArray[Any]]:
        """Arrays of M rows that a checkpoint keeps."""
        states = {_RULE + name: array for name, array in self._states.items()}
        return {_COPIES: self._copies, _COPIED: self._copied} | states

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Takes the arrays of `state` out of a checkpoint.

        Raises:
            MessageRejected: they do not fit.
        """
        kept = {
            name: expect(name, state.pop(name, NOBODY), array.shape, array.dtype).copy()
            for name, array in self.state().items()
        }
        self._copies, self._copied = kept.pop(_COPIES), kept.pop(_COPIED)
        self._states = {name.removeprefix(_RULE): array for name, array in kept.items()}

    def _one(self, row: int, copy: Floats, received: Uploads, delivered: Mask) -> Floats | None:
        """The average of one row by a rule that is not linear; None where the rule waits for more."""
        uav = self._uavs[row]
        place = int(received.uavs[delivered].searchsorted(uav))
        uploads = Uploads(
            np.insert(received.models[delivered], place, copy, axis=0),
            np.insert(received.uavs[delivered], place, uav),
            np.insert(received.sent[delivered], place, received.round),
            received.round,
        )
        before = {name: array[row] for name, array in self._states.items()}
        after, average = self._rule.step(before, uploads)
        for name, array in after.items():
            self._states[name][row] = array
        return average


def _merged(batches: list[Frames], coding: Coding, uavs: Indices) -> tuple[Indices, Indices, Floats, Mask]:
    """The models that were sent: of which UAVs, ascending (S,), in which rounds, ascending for each UAV (S,).

    Further the models (S, L), and which row averages which (M, S): of several models of a UAV the latest.
    """
    if not batches:
        none = np.zeros(0, dtype=np.intp)
        return none, none, np.zeros((0, coding.floats)), np.zeros((len(uavs), 0), dtype=bool)
    last = max(batch.round for batch in batches)
    pairs = [2 * batch.source.astype(np.intp) + (batch.round == last) for batch in batches]  # of UAV and round
    found = np.unique(np.concatenate(pairs))
    models = np.zeros((len(found), coding.floats))
    delivered = np.zeros((len(uavs), len(found)), dtype=bool)
    for batch, pair in zip(batches, pairs, strict=True):
        assert batch.links is not None
        place = found.searchsorted(pair)
        models[place] = coding.decode(batch.payload)
        delivered[uavs.searchsorted(batch.links[:, 1]), place[batch.links[:, 0]]] = True
    senders = found // 2
    again = np.flatnonzero(senders[1:] == senders[:-1])  # a model whose UAV sent another one later
    delivered[:, again] &= ~delivered[:, again + 1]
    return senders, last - 1 + found % 2, models, delivered


def _weighted(models: Floats, weights: Floats, own: Floats, own_weights: Floats, delivered: Mask) -> Floats:
    """Weighted means (R, L) of the models (S, L) that each row received, (R, S), and of its own, (R, L)."""
    total, weight = np.zeros_like(own), np.zeros(len(own))
    for place, model in enumerate(models):
        share = np.where(delivered[:, place], weights[place], 0.0)
        total += share[:, None] * model
        weight += share
    return (total + own_weights[:, None] * own) / (weight + own_weights)[:, None]
