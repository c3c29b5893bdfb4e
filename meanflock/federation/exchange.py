"""Exchange: the UAVs of one node average what they receive with their own models, where no leader does it for them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.averager import Rule, RuleFailed
from meanflock.federation.mail import Collector, Joined, OwnModel
from meanflock.federation.plan import Plan
from meanflock.federation.rules.base import Uploads
from meanflock.federation.topology.base import Hop
from meanflock.swarm.state import Floats, Mask

_COPIES, _COPIED, _SAMPLES = "meanflock.copies", "meanflock.copied", "meanflock.samples"  # in a checkpoint
_RULE = "meanflock.rule."

Indices = NDArray[np.intp]


class Exchange(Collector):
    """Own models and mail of M UAVs, and the state that the aggregation rule has in each of them.

    Sums go by ascending UAV, the own model last: neither the order of arrival nor the other rows leave a trace.
    """

    def __init__(self, hop: Hop, plan: Plan, uavs: Indices, problems: list[str]) -> None:
        """`uavs`: (M,) ascending. `problems`: texts about a rule that fails are appended.

        Raises:
            BadInput: the aggregation rule cannot begin.
        """
        super().__init__(hop, plan.scenario, uavs)
        self._problems = problems
        self._rule = Rule(plan)
        self._states = {name: np.repeat(array[None], len(uavs), axis=0) for name, array in self._rule.begin().items()}
        self._copies = np.zeros((len(uavs), self._coding.floats))  # (M, L) own models, as the coding leaves them
        self._samples = np.ones(len(uavs))  # (M,) what they count
        self._copied = np.zeros(len(uavs), dtype=np.int64)  # (M,) the rounds of these copies

    def remember(self, number: int, rows: Indices, payload: np.ndarray) -> None:
        """Keeps the own models of rows (S,) for a round, as payloads (S, width), but for those that cannot be sent."""
        numbers, samples = self._coding.unpack(payload)
        valid = self._coding.valid(numbers)
        self._copies[rows[valid]] = self._coding.decode(numbers[valid])
        self._samples[rows[valid]] = samples[valid, 0]
        self._copied[rows[valid]] = number

    def average(self, number: int, awake: Mask) -> tuple[Indices, Floats, list[int]]:
        """The averages of a round in the rows that are `awake` (M,); its mail is forgotten.

        Returns:
            The rows that have an average, (R,): not those that received nothing, or had no model when the round opened.
            Their averages (R, L). The UAVs whose models cannot be averaged, ascending.
        """
        joined = self.close(number)
        rows = np.flatnonzero(awake & (self._copied == number) & joined.arrived.any(axis=(1, 2)))
        if not len(rows):
            return rows, np.zeros((0, self._coding.floats)), joined.refused
        own = self._copies[rows]
        try:
            weights = self._rule.weights(_uploads(joined.models(), joined.weights.max(axis=1), joined, number))
            own_weights = self._rule.weights(Uploads.complete(own, number, self.uavs[rows], self._samples[rows]))
        except RuleFailed as error:
            self._problems.append(str(error))
            return rows[:0], own[:0], joined.refused
        if weights is not None and own_weights is not None:
            return rows, _weighted(joined, weights, own, own_weights, rows), joined.refused
        taken = []
        averages = []
        failures = list[str]()
        for row in rows.tolist():
            try:
                average = self._one(row, number, joined)
            except RuleFailed as error:  # this row keeps its model, and its state of the rule
                failures.append(str(error))
                continue
            if average is not None:
                taken.append(row)
                averages.append(average)
        self._problems += dict.fromkeys(failures)
        return np.array(taken, dtype=np.intp), np.array(averages).reshape(-1, self._coding.floats), joined.refused

    def state(self) -> dict[str, NDArray[Any]]:
        """Arrays of M rows that a checkpoint keeps, and that may be written to."""
        states = {_RULE + name: array for name, array in self._states.items()}
        return {_COPIES: self._copies, _COPIED: self._copied, _SAMPLES: self._samples} | states

    def _one(self, row: int, number: int, joined: Joined) -> Floats | None:
        """The average of one row by a rule that is not linear; None where the rule waits for more."""
        own = OwnModel(int(self.uavs[row]), self._copies[row], float(self._samples[row]))
        uploads, *_ = joined.to(row, number, own)
        before = {name: array[row] for name, array in self._states.items()}
        after, average = self._rule.step(before, uploads)
        for name, array in after.items():
            self._states[name][row] = array
        return average


def _uploads(models: Floats, samples: Floats, joined: Joined, number: int) -> Uploads:
    """All models of a round, whoever received them; slots, which differ by receiver, are 0."""
    arrived = joined.by_weight(np.logical_or.reduce(joined.arrived))
    slots = np.zeros(len(models), dtype=np.int64)
    return Uploads(models, joined.senders, joined.sent, slots, samples, arrived, number)


def _weighted(joined: Joined, weights: Floats, own: Floats, own_weights: Floats, rows: Indices) -> Floats:
    """Weighted means (R, L) of the models (S, L) that each of some rows received, and of its own, (R, L)."""
    means, size = np.empty_like(own), joined.values.shape[2]
    arrived = joined.arrived[rows]
    for fragment in range(joined.values.shape[1]):
        here = slice(fragment * size, min((fragment + 1) * size, own.shape[1]))
        mine = own[:, here]
        total, weight = np.zeros_like(mine), np.zeros(len(rows))
        for place, model in enumerate(joined.values[:, fragment, : mine.shape[1]]):
            share = np.where(arrived[:, place, fragment], weights[place], 0.0)
            total += share[:, None] * model
            weight += share
        means[:, here] = (total + own_weights[:, None] * mine) / (weight + own_weights)[:, None]
    return means
