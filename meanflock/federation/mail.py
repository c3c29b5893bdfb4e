"""Mail: the models that arrived at some UAVs in one round, put together from fragments or whole."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.coding import Coding
from meanflock.federation.rules.base import Uploads
from meanflock.federation.topology.base import Hop
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask, contains
from meanflock.swarm.wire.messages import Frames

Indices = NDArray[np.intp]

ABSURD = 1e9  # no weight of a learner that still learns: features are of order one, and so are the costs
RECEIPT = np.dtype("<i4")  # of a batch that says how many slots the models before it were on the air


class Mail:
    """Models of S senders, ascending, in F fragments each; a whole model is one fragment.

    Attributes:
        senders: (S,) the UAVs that the models are of.
        values: (S, F, n) their weights, floats as wide as on the air; 0 in fragments that nobody received.
        weights: (S, F) what each counts: the weight that its UAV declares, of an average the sum over its models; their
            number where no weights are declared.
        behind: (S, F) number of models that each is the mean of; 1 for uploads.
        arrived: (A, S, F) which of the A UAVs that average received which fragment.
        slots: (A, S) slots that the models were on the air to each of them.
    """

    def __init__(self, coding: Coding, uavs: Indices) -> None:
        """`uavs`: (A,) the UAVs that average, ascending."""
        self._coding, self._uavs = coding, uavs
        size = coding.floats if coding.fragments is None else coding.fragments.cut.size
        self.senders: Indices = np.zeros(0, dtype=np.intp)
        self.values: NDArray[np.floating] = np.zeros((0, coding.count, size), dtype=coding.held)
        self.weights: Floats = np.zeros((0, coding.count))
        self.behind: Floats = np.zeros((0, coding.count))
        self.arrived: Mask = np.zeros((len(uavs), 0, coding.count), dtype=bool)
        self.slots: NDArray[np.int64] = np.zeros((len(uavs), 0), dtype=np.int64)

    def add(self, frames: Frames) -> None:
        """Adds frames that passed `Coding.check_received`, or their receipt; a second copy changes nothing."""
        assert frames.links is not None
        self._make_room(frames.source)
        place = self.senders.searchsorted(frames.source)
        row = frames.links[:, 0]
        target = self._uavs.searchsorted(frames.links[:, 1])
        if frames.payload.dtype == RECEIPT:
            cell = target * len(self.senders) + place[row]
            spent = np.bincount(cell, weights=frames.payload[row, 0], minlength=self.slots.size)
            self.slots += spent.astype(np.int64).reshape(self.slots.shape)
            return
        pieces = self._coding.received(frames.payload)
        new = np.zeros(len(place), dtype=bool)
        new[row] = True
        new &= ~self.arrived[:, place, pieces.numbers].any(axis=0)
        chosen = slice(None) if new.all() else new
        where = place[chosen], pieces.numbers[chosen]
        self.values[where] = pieces.values[chosen]
        self.weights[where] = pieces.weights[chosen]
        self.behind[where] = pieces.behind[chosen]
        self.arrived[target, place[row], pieces.numbers[row]] = True

    def _make_room(self, source: NDArray[np.integer]) -> None:
        """Gives every sender its place."""
        if contains(self.senders, source).all():
            return
        senders = np.union1d(self.senders, source).astype(np.intp)
        place = senders.searchsorted(self.senders)
        self.senders = senders
        self.values = _spread(self.values, place, len(senders))
        self.weights = _spread(self.weights, place, len(senders))
        self.behind = _spread(self.behind, place, len(senders))
        self.arrived = _spread(self.arrived, place, len(senders), axis=1)
        self.slots = _spread(self.slots, place, len(senders), axis=1)


def usable(values: NDArray[np.floating]) -> Mask:
    """Mask (S,) of the models (S, F, n) that can be averaged: those that are finite and not absurdly large."""
    with np.errstate(invalid="ignore"):  # NaN is neither above nor below anything
        rows = values.reshape(len(values), values.shape[1] * values.shape[2])
        largest, least = (extreme.astype(np.float64) for extreme in (rows.max(axis=1), rows.min(axis=1)))
        return np.asarray((largest < ABSURD) & (least > -ABSURD))


class Joined:
    """All that some UAVs average in a round: its mail, and mail of earlier rounds that came after these were averaged.

    Of several models of a sender the latest one counts, in each fragment that arrived of it.

    Attributes:
        senders, sent: (S,) UAVs, ascending, and the rounds in which they sent these models, ascending for each UAV.
        values, weights, behind, arrived, slots: as those of `Mail`.
        refused: UAVs whose models cannot be averaged, ascending.
    """

    def __init__(self, mails: dict[int, Mail], coding: Coding, uavs: Indices) -> None:
        """`mails`: by the round in which they were sent, ascending."""
        self._floats, self._uavs = coding.floats, uavs
        parts = list(mails.values()) or [Mail(coding, uavs)]
        numbers = list(mails) or [0]
        self.senders = np.concatenate([mail.senders for mail in parts])
        self.sent = np.repeat(numbers, [len(mail.senders) for mail in parts])
        order = np.argsort(self.senders, kind="stable")
        is_usable = np.concatenate([usable(mail.values) for mail in parts])[order]
        self.refused: list[int] = np.unique(self.senders[order][~is_usable]).tolist()
        order = order[is_usable]
        self.senders, self.sent = self.senders[order], self.sent[order]
        self.values = _in_order([mail.values for mail in parts], order)
        self.weights = _in_order([mail.weights for mail in parts], order)
        self.behind = _in_order([mail.behind for mail in parts], order)
        self.arrived = np.concatenate([mail.arrived for mail in parts], axis=1)[:, order]
        self.slots = np.concatenate([mail.slots for mail in parts], axis=1)[:, order]
        again = np.flatnonzero(self.senders[1:] == self.senders[:-1])  # models whose UAVs sent another one later
        newer = self.arrived.copy()
        for place in again[::-1].tolist():
            newer[:, place] |= newer[:, place + 1]
            self.arrived[:, place] &= ~newer[:, place + 1]

    def models(self) -> Floats:
        """The models, (S, L)."""
        return self._flat(self.values.astype(np.float64))

    def _flat(self, values: Floats) -> Floats:
        """Models by fragment (S, F, n) as models (S, L)."""
        count, fragments, size = values.shape
        return values.reshape(count, fragments * size)[:, : self._floats]

    def _filled_up(self, model: Floats) -> Floats:
        """A model (L,) by fragment, (F, n), with zeros behind its last weight."""
        _, fragments, size = self.values.shape
        return np.pad(model, (0, fragments * size - self._floats)).reshape(fragments, size)

    def by_weight(self, table: NDArray[Any]) -> NDArray[Any]:
        """A table by fragment (S, F) as a table by weight of the model, (S, L)."""
        return np.repeat(table, self.values.shape[2], axis=1)[:, : self._floats]

    def to(self, row: int, number: int, own: "OwnModel | None" = None) -> tuple[Uploads, Floats, Floats]:
        """The models that the UAV at place `row` averages in a round; `own`: its own model, if it is not in the mail.

        Returns:
            The models. What each counts by fragment, (S, F), and how many models it is the mean of there, (S, F); both
            are 0 where the fragment did not arrive.
        """
        here = np.flatnonzero(self.arrived[row].any(axis=1))
        uavs, place = np.unique(self.senders[here], return_inverse=True)
        arrived = self.arrived[row, here]
        values = (self.values if len(here) == len(self.values) else self.values[here]).astype(np.float64)
        counts = self.weights[here] * arrived
        behind = self.behind[here] * arrived
        sent, slots = self.sent[here], self.slots[row, here]
        if len(self._uavs) > 1 and not arrived.all():  # fragments that only other UAVs received
            values[~arrived] = 0.0
        if len(uavs) < len(here):  # parts of earlier and of later models of the same UAVs
            first = np.searchsorted(place, np.arange(len(uavs)))
            last = np.searchsorted(place, np.arange(len(uavs)), side="right") - 1
            values = np.add.reduceat(values, first, axis=0)
            counts = np.add.reduceat(counts, first, axis=0)
            behind = np.add.reduceat(behind, first, axis=0)
            arrived = np.logical_or.reduceat(arrived, first, axis=0)
            slots, sent = np.add.reduceat(slots, first), sent[last]
        samples = counts.max(axis=1, initial=0.0)
        if own is not None:
            at = int(uavs.searchsorted(own.uav))
            uavs = np.insert(uavs, at, own.uav)
            sent = np.insert(sent, at, number)
            slots = np.insert(slots, at, 0)
            samples = np.insert(samples, at, own.samples)
            counts = np.insert(counts, at, own.samples, axis=0)
            behind = np.insert(behind, at, 1.0, axis=0)
            values = np.insert(values, at, self._filled_up(own.model), axis=0)
            arrived = np.insert(arrived, at, True, axis=0)
        models, by_weight = self._flat(values), self.by_weight(arrived)
        uploads = Uploads(models, uavs.astype(np.intp), sent, slots, samples, by_weight, number)
        if not arrived.all():
            sender, fragment = np.nonzero(~arrived)
            values[sender, fragment] = self._filled_up(uploads.mean)[fragment]
        return uploads, counts, behind


class Collector:
    """The mail of the UAVs that average for one hop, by round.

    Attributes:
        hop: the hop.
        uavs: (A,) the UAVs of this node that average, ascending.
    """

    def __init__(self, hop: Hop, scenario: Scenario, uavs: Indices) -> None:
        assert hop.mail is not None
        self.hop, self.uavs = hop, uavs
        self._coding = hop.mail.coding
        self._mails: dict[int, Mail] = {}  # by round
        self._takes_late = scenario.federation.deadline is not None

    def collect(self, frames: Frames) -> None:
        """Stores mail of this hop."""
        if frames.round not in self._mails:
            self._mails[frames.round] = Mail(self._coding, self.uavs)
        self._mails[frames.round].add(frames)

    def close(self, number: int) -> Joined:
        """All that a round averages; forgets its mail and that of all rounds before it."""
        closed = {of_round: self._mails.pop(of_round) for of_round in sorted(self._mails) if of_round <= number}
        due = {of_round: mail for of_round, mail in closed.items() if self._takes_late or of_round == number}
        return Joined(due, self._coding, self.uavs)


class OwnModel(NamedTuple):
    """The model of a UAV that averages, as its coding leaves it: (L,), and what it counts."""

    uav: int
    model: Floats
    samples: float


def _spread(table: NDArray[Any], place: Indices, count: int, axis: int = 0) -> NDArray[Any]:
    """A table of `count` rows along an axis: those of a smaller table at the places `place`, all others 0."""
    shape = list(table.shape)
    shape[axis] = count
    result = np.zeros(shape, table.dtype)
    result[(slice(None),) * axis + (place,)] = table
    return result


def _in_order(tables: list[NDArray[Any]], order: Indices) -> NDArray[Any]:
    """Tables of rows joined in an order; no copy of the only one if it is in order already."""
    joined = tables[0] if len(tables) == 1 else np.concatenate(tables)
    return joined if len(order) == len(joined) and (order == np.arange(len(order))).all() else joined[order]
