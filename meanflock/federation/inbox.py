"""Inbox: the models that arrived at the UAVs of a node that average, put together from their fragments, by rounds."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.codec import Codec, based_of, notes_of
from meanflock.federation.memory import OwnModels
from meanflock.federation.rules.base import Uploads, mean
from meanflock.swarm.state import Floats, Mask, contains, distinct
from meanflock.swarm.wire.messages import Frames

Indices = NDArray[np.intp]

ABSURD = 1e9  # no weight of a learner that still learns: features are of order one, and so are the costs
RECEIPT = np.dtype("<i4")  # of a batch that says how many slots the models before it were on the air
_AT_ONCE = 2**16  # numbers that are averaged together: they fit into the caches


class Round:
    """The models that some UAVs average in a round, S of them in F fragments each.

    A sender has several rows if an upload of an earlier round came late; of each fragment its latest copy counts.

    Attributes:
        number: of the round. uavs: (A,) the UAVs that average, ascending.
        senders: (S,) the UAVs that the models are of, ascending. sent: (S,) rounds in which they were sent.
        values: (S, F, n) numbers, floats as wide as on the air; 0 in fragments that nobody received.
        weights: (S, F) what each counts: the weight that its UAV declares, of an average the sum over its models; their
            number where no weights are declared.
        behind: (S, F) number of models that each is the mean of; 1 for uploads.
        heads: (S, B) bytes of the heads. arrived: (A, S, F) which UAV received which fragment.
        slots: (A, S) slots that the models were on the air to each of them.
        refused: UAVs whose models cannot be averaged, ascending.
        own: models of the UAVs that average, where they are not among the others; None: they are.
    """

    def __init__(self, number: int, codec: Codec, uavs: Indices) -> None:
        size = codec.size
        self.number = number
        self.uavs = uavs
        self.senders: Indices = np.zeros(0, dtype=np.intp)
        self.sent: Indices = np.zeros(0, dtype=np.intp)
        self.values: NDArray[np.floating] = np.zeros((0, codec.count, size), dtype=codec.held)
        self.weights: Floats = np.zeros((0, codec.count))
        self.behind: Floats = np.zeros((0, codec.count))
        self.heads: NDArray[np.uint8] = np.zeros((0, codec.form.head), dtype=np.uint8)
        self.arrived: Mask = np.zeros((len(uavs), 0, codec.count), dtype=bool)
        self.slots: NDArray[np.int64] = np.zeros((len(uavs), 0), dtype=np.int64)
        self.refused: list[int] = []
        self.own: OwnModels | None = None
        self._codec = codec

    # -- what arrives ---------------------------------------------------------------------------------------------

    def add(self, frames: Frames) -> None:
        """Adds frames that passed `Codec.check`, or their receipt; a second copy changes nothing."""
        assert frames.links is not None
        place = self._rows(frames.source, frames.round)
        row = frames.links[:, 0]
        target = self.uavs.searchsorted(frames.links[:, 1])
        if frames.payload.dtype == RECEIPT:
            cell = target * len(self.senders) + place[row]
            spent = np.bincount(cell, weights=frames.payload[row, 0], minlength=self.slots.size)
            self.slots += spent.astype(np.int64).reshape(self.slots.shape)
            return
        pieces = self._codec.read(frames.payload)
        new = np.zeros(len(place), dtype=bool)
        new[row] = True
        new &= ~self.arrived[:, place, pieces.places].any(axis=0)
        chosen = slice(None) if new.all() else new
        where = place[chosen], pieces.places[chosen]
        self.values[where] = pieces.values[chosen]
        self.weights[where] = pieces.weights[chosen]
        self.behind[where] = pieces.behind[chosen]
        if self._codec.form.head:
            first = new & (pieces.places == 0)
            self.heads[place[first]] = pieces.heads[first]
        self.arrived[target, place[row], pieces.places[row]] = True

    def _rows(self, source: NDArray[np.integer], number: int) -> Indices:
        """The rows of senders in a round; those that have none yet get one."""
        keys = self.senders * _ROUNDS + self.sent
        wanted = source.astype(np.intp) * _ROUNDS + number
        if not contains(keys, wanted).all():
            every = distinct(np.concatenate([keys, wanted]))
            place, count = every.searchsorted(keys), len(every)
            self.senders, self.sent = np.divmod(every, _ROUNDS)
            self.values, self.weights, self.behind, self.heads = (
                _spread(table, place, count) for table in (self.values, self.weights, self.behind, self.heads)
            )
            self.arrived = _spread(self.arrived, place, count, axis=1)
            self.slots = _spread(self.slots, place, count, axis=1)
            keys = every
        return keys.searchsorted(wanted)

    def take(self, number: int, *, late: bool) -> "Round":
        """The round of a number, with the models that were sent in it, and before if `late`; they leave this one."""
        round_ = self._picked(self.sent <= number if late else self.sent == number)
        round_.number = number
        rest = self._picked(self.sent > number)
        vars(self).update(vars(rest))
        round_._settle()
        return round_

    def _picked(self, rows: Mask) -> "Round":
        """A round of some of the rows (S,)."""
        picked = Round.__new__(Round)
        vars(picked).update(vars(self))
        if not rows.all():
            for name in ("senders", "sent", "values", "weights", "behind", "heads"):
                setattr(picked, name, getattr(self, name)[rows])
            picked.arrived, picked.slots = self.arrived[:, rows], self.slots[:, rows]
        return picked

    def _settle(self) -> None:
        """Leaves out models that cannot be averaged, and earlier copies of fragments that arrived again."""
        is_usable = usable(self.values)
        if not is_usable.all():
            self.refused = distinct(self.senders[~is_usable]).tolist()
            vars(self).update(vars(self._picked(is_usable)))
        again = np.flatnonzero(self.senders[1:] == self.senders[:-1])  # models whose UAVs sent another one later
        newer = self.arrived.copy() if len(again) else self.arrived
        for place in again[::-1].tolist():
            newer[:, place] |= newer[:, place + 1]
            self.arrived[:, place] &= ~newer[:, place + 1]

    # -- what is averaged -----------------------------------------------------------------------------------------

    @property
    def all_uploads(self) -> Uploads:
        """All models, whoever received them; slots, which differ by receiver, are 0."""
        nowhere = np.zeros(len(self.senders), dtype=np.int64)
        arrived = np.logical_or.reduce(self.arrived)
        headed = arrived[:, 0]
        return _Lazy(self, self.values, arrived, self.senders, self.sent, nowhere, self.weights, self.heads, headed)

    @property
    def own_uploads(self) -> Uploads:
        """The own models of the UAVs that average."""
        assert self.own is not None
        return Uploads.complete(self.own.models, self.number, self.uavs, self.own.samples)

    def uploads(self, row: int) -> Uploads:
        """The models that the UAV at place `row` averages, its own among them."""
        here = np.flatnonzero(self.arrived[row].any(axis=1))
        uavs, place = np.unique(self.senders[here], return_inverse=True)
        arrived = self.arrived[row, here]
        values = (self.values if len(here) == len(self.values) else self.values[here]).astype(np.float64)
        counts = self.weights[here] * arrived
        sent, slots, headed = self.sent[here], self.slots[row, here], arrived[:, 0]
        heads = self.heads[here] * headed[:, None]
        if not arrived.all():  # fragments that only other UAVs received, or that came again later
            values[~arrived] = 0.0
        if len(uavs) < len(here):  # parts of earlier and of later models of the same UAVs
            first = np.searchsorted(place, np.arange(len(uavs)))
            last = np.searchsorted(place, np.arange(len(uavs)), side="right") - 1
            values = np.add.reduceat(values, first, axis=0)
            counts = np.add.reduceat(counts, first, axis=0)
            arrived = np.logical_or.reduceat(arrived, first, axis=0)
            slots, sent, heads, headed = np.add.reduceat(slots, first), sent[last], heads[last], headed[last]
        if self.own is not None:
            uav = self.uavs[row]
            at = int(uavs.searchsorted(uav))
            uavs = np.insert(uavs, at, uav)
            sent = np.insert(sent, at, self.number)
            slots = np.insert(slots, at, 0)
            counts = np.insert(counts, at, self.own.samples[row], axis=0)
            values = np.insert(values, at, self._codec.fragments(self.own.models[row : row + 1])[0], axis=0)
            arrived = np.insert(arrived, at, True, axis=0)
            heads, headed = np.insert(heads, at, 0, axis=0), np.insert(headed, at, False)
        return _Lazy(self, values, arrived, uavs.astype(np.intp), sent, slots, counts, heads, headed)

    def means(self, rows: Indices, factors: Floats, own_factors: Floats | None = None) -> Floats:
        """Weighted means (R, L) of the models that the UAVs at places `rows` (R,) received, 0 where nothing arrived.

        Args:
            factors: (S,) or (S, F), what each model counts. own_factors: (A,), likewise their own models, added last.
        """
        count, fragments, size = len(rows), *self.values.shape[1:]
        table = np.broadcast_to(factors if factors.ndim == 2 else factors[:, None], self.values.shape[:2])
        arrived = self.arrived[rows]
        means = np.empty((count, fragments, size))
        own = None if self.own is None else self._codec.fragments(self.own.models[rows])
        some = max(1, _AT_ONCE // (count * size))
        for first in range(0, fragments, some):
            here = slice(first, first + some)
            total = np.zeros_like(means[:, here])
            weight = np.zeros(total.shape[:2])
            for place, model in enumerate(self.values[:, here]):
                share = np.where(arrived[:, place, here], table[place, here], 0.0)
                total += share[:, :, None] * model
                weight += share
            if own is not None and own_factors is not None:
                total += own_factors[rows, None, None] * own[:, here]
                weight += own_factors[rows, None]
            means[:, here] = total / np.where(weight > 0.0, weight, 1.0)[:, :, None]
        return self._codec.model(means)

    def stands_for(self, rows: Indices) -> tuple[Floats, Floats]:
        """Sum of the weights of the models behind each fragment of the averages at places `rows`, and their number,
        (R, F) each."""
        arrived = self.arrived[rows]
        return (self.weights * arrived).sum(axis=1), (self.behind * arrived).sum(axis=1)


_ROUNDS = 2**32  # more than a flight has


class _Lazy(Uploads):
    """Uploads of a round, whose models are only made if a rule reads them."""

    def __init__(
        self,
        round_: Round,
        values: NDArray[np.floating],
        arrived: Mask,
        uavs: Indices,
        sent: NDArray[np.integer],
        slots: NDArray[np.integer],
        counts: Floats,
        heads: NDArray[np.uint8],
        headed: Mask,
    ) -> None:
        """Values (S, F, n), what arrived (S, F) and counts (S, F), 0 where nothing did; `headed` (S,): heads that
        arrived."""
        self._codec, self._values, self._arrived = round_._codec, values, arrived
        self.uavs, self.sent, self.slots, self.round = uavs, sent, slots, round_.number
        self.samples = counts.max(axis=1, initial=0.0)
        self.based = np.where(headed, based_of(heads), sent - 1) if heads.shape[1] else sent - 1
        self.notes = notes_of(heads)

    @cached_property
    def arrived(self) -> Mask:  # type: ignore[override]
        """See `Uploads`."""
        table: Mask = self._codec.by_number(self._arrived)
        return table

    @cached_property
    def models(self) -> Floats:  # type: ignore[override]
        """See `Uploads`."""
        values = self._values.astype(np.float64, copy=False)
        models: Floats = self._codec.model(values)
        return models if self._arrived.all() else np.where(self.arrived, models, mean(models, None, self.arrived))


def usable(values: NDArray[np.floating]) -> Mask:
    """Mask (S,) of the models (S, F, n) that can be averaged: those that are finite and not absurdly large."""
    with np.errstate(invalid="ignore"):  # NaN is neither above nor below anything
        rows = values.reshape(len(values), values.shape[1] * values.shape[2])
        largest, least = (extreme.astype(np.float64) for extreme in (rows.max(axis=1), rows.min(axis=1)))
        return np.asarray((largest < ABSURD) & (least > -ABSURD))


def _spread(table: NDArray[Any], place: Indices, count: int, axis: int = 0) -> NDArray[Any]:
    """A table of `count` rows along an axis: those of a smaller table at the places `place`, all others 0."""
    shape = list(table.shape)
    shape[axis] = count
    result = np.zeros(shape, table.dtype)
    result[(slice(None),) * axis + (place,)] = table
    return result
