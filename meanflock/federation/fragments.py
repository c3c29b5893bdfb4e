"""Fragments: how a model that is too long for one message is cut, transmitted and put together again.

A fragment is a row of bytes with n weights of the model, and what it takes to read them without the others:

    number   uint32, k for the weights from k·n on
    weight   float32, what the sender's model counts, if the coding has that; of an average the sum over its models
    weights  n numbers as the coding writes them, the last fragment filled up with zeros
    count    one such number, how many models these weights are the mean of, if the coding has that
    scales   float32, of 8-bit steps: one for each part of the model that the fragment touches

All of it is transmitted, paid for, and lost or delivered as one message.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import plugins, state
from meanflock.swarm.errors import FAILURES, MessageRejected, last_line
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats
from meanflock.swarm.wire.control import expect

WHOLE = 0  # value of `federation.fragment`: no model is cut
SUCCESS = 0.95  # expected share of fragments that are delivered, from which a size is long enough
_NUMBER = np.dtype("<u4")
_FLOAT32 = np.dtype("<f4")
_BYTE = np.dtype("u1")
_KEPT = 2**25 - 2**13  # bytes; the largest block to which glibc adapts, less its own head and a page


class Cut(NamedTuple):
    """The cut of a scenario's models, one for all hops, so that a fragment of an average is one of fragments.

    slots: that a fragment takes at most. size: n, its weights. per_tick: fragments that a UAV transmits in a tick.
    """

    slots: int
    size: int
    per_tick: int


class CodingForm(NamedTuple):
    """Properties of a coding that decide what a fragment holds.

    item: dtype of a weight on the air. counted: each fragment has the number of models behind it. weighted: each has
    the weight that its sender declares, or the sum of such weights. scaled: weights are steps of scales.
    """

    item: np.dtype
    counted: bool = False
    weighted: bool = False
    scaled: bool = False

    def weights(self, most: int, parts: tuple[int, ...]) -> int:
        """Weights in a fragment of at most `most` bytes, of models whose parts have so many weights."""
        room = most - _NUMBER.itemsize - _FLOAT32.itemsize * self.weighted - self.item.itemsize * self.counted
        size, scales = room // self.item.itemsize, 0
        while self.scaled and size >= 1 and _most_pieces(parts, size) > scales:
            scales += 1
            size = room - _FLOAT32.itemsize * scales
        return size


class Pieces(NamedTuple):
    """Fragments that were read, R of them.

    numbers: (R,). values: (R, n) weights of the model. weights: (R,), what the sender's model counts in this fragment.
    behind: (R,), number of models that it is the mean of; 1 for uploads.
    """

    numbers: NDArray[np.intp]
    values: NDArray[np.floating]
    weights: Floats
    behind: Floats


class Fragments:
    """The cut of the payloads of one coding. Rows are independent, to the last bit.

    Attributes:
        count: F, fragments of a model.
        cut: how the scenario cuts models.
        width: bytes of a fragment.
    """

    def __init__(self, cut: Cut, floats: int, starts: NDArray[np.intp], form: CodingForm) -> None:
        """
        Args:
            cut: how the scenario cuts models.
            floats: L, weights of a model.
            starts: first weights of the pieces that have a scale each, ascending; a piece lies in one fragment.
            form: what a fragment holds.
        """
        self.cut = cut
        self.count = -(-floats // cut.size)
        size = cut.size
        self._floats = floats
        self._form = form
        self._head = _NUMBER.itemsize + _FLOAT32.itemsize * form.weighted
        self._end = self._head + size * form.item.itemsize
        self._scale_of: NDArray[np.intp] = np.zeros((self.count, 0), dtype=np.intp)  # (F, scales of a fragment)
        if form.scaled:
            first = np.searchsorted(starts, np.arange(self.count) * size)
            pieces = np.diff(first, append=len(starts))
            self._scale_of = np.minimum(first[:, None] + np.arange(pieces.max()), len(starts) - 1)
            piece = np.searchsorted(starts, np.arange(self.count * size), side="right") - 1  # of each weight
            self._own_scale = piece.reshape(self.count, size) - first[:, None]  # among those of its fragment
        scales = self._scale_of.shape[1]
        self.width = self._head + (size + form.counted) * form.item.itemsize + _FLOAT32.itemsize * scales
        _keep_freed_blocks()

    @property
    def ticks(self) -> int:
        """Ticks in which the fragments of a model are transmitted."""
        return -(-self.count // self.cut.per_tick)

    def rows(self, numbers: np.ndarray, weights: Floats, ready: slice = slice(None)) -> NDArray[np.uint8]:
        """Models `(S, …)`, written by a coding, and declared weights (S, 1) or (S, F), as fragments `(S, T, width)`.

        `ready`: the T fragments that are wanted, by their numbers; all F where left out.
        """
        size, chosen = self.cut.size, np.arange(self.count, dtype=_NUMBER)[ready]
        rows = np.empty((len(numbers), len(chosen), self.width), dtype=_BYTE)
        rows[:, :, : _NUMBER.itemsize] = chosen[:, None].view(_BYTE)
        if self._form.weighted:
            each = np.broadcast_to(weights.astype(_FLOAT32), (len(numbers), self.count))[:, ready, None]
            rows[:, :, _NUMBER.itemsize : self._head] = np.ascontiguousarray(each).view(_BYTE)
        first = int(chosen[0]) * size
        model = numbers[:, first : min(first + len(chosen) * size, self._floats)]
        full = model.shape[1] // size  # fragments of this turn but for one that is filled up with zeros
        written = rows[:, :, self._head : self._end]
        written[:, :full] = model[:, : full * size].reshape(len(model), full, size).view(_BYTE)
        if full < len(chosen):
            written[:, full] = 0
            rest = model[:, full * size :].view(_BYTE)
            written[:, full, : rest.shape[1]] = rest
        if self._form.counted:
            counts = np.ascontiguousarray(numbers[:, self._floats :][:, ready, None])
            rows[:, :, self._end :] = counts.view(_BYTE)
        if self._form.scaled:
            scales = np.ascontiguousarray(numbers[:, self._floats :]).view(_FLOAT32)
            rows[:, :, self._end :] = np.ascontiguousarray(scales[:, self._scale_of[ready]]).view(_BYTE)
        return rows

    def numbers(self, rows: NDArray[np.uint8]) -> NDArray[np.intp]:
        """The numbers of fragments `(R, width)`, (R,)."""
        return np.ascontiguousarray(rows[:, : _NUMBER.itemsize]).view(_NUMBER)[:, 0].astype(np.intp)

    def read(self, rows: NDArray[np.uint8]) -> Pieces:
        """The valid contents of fragments `(R, width)`; floats have the width that they have on the air."""
        numbers = self.numbers(rows)
        if not self._form.scaled:
            return Pieces(numbers, self._written(rows), self.weights(rows), self.behind(rows))
        spread = np.take_along_axis(self.scales(rows), self._own_scale[numbers], axis=-1).astype(np.float64)
        return Pieces(numbers, self._written(rows) * spread, self.weights(rows), self.behind(rows))

    def weights(self, rows: NDArray[np.uint8]) -> Floats:
        """The weights of models in fragments `(R, width)`, (R,): declared, or the numbers of models."""
        if self._form.weighted:
            return np.ascontiguousarray(rows[:, _NUMBER.itemsize : self._head]).view(_FLOAT32)[:, 0].astype(float)
        return self.behind(rows)

    def behind(self, rows: NDArray[np.uint8]) -> Floats:
        """The numbers of models behind fragments `(R, width)`, (R,)."""
        if self._form.counted:
            return np.ascontiguousarray(rows[:, self._end :]).view(self._form.item)[:, 0].astype(float)
        return np.ones(len(rows))

    def is_valid(self, rows: NDArray[np.uint8]) -> bool:
        """Returns whether all fragments `(R, width)` have floats that are finite, or steps that are ever sent."""
        written = self._written(rows)
        return bool((written > -128).all() if self._form.scaled else np.isfinite(written).all())

    def _written(self, rows: NDArray[np.uint8]) -> NDArray[Any]:
        """The numbers for the weights, (R, n): floats, or steps."""
        return rows[:, self._head : self._end].view(np.int8 if self._form.scaled else self._form.item)

    def scales(self, rows: NDArray[np.uint8]) -> NDArray[np.float32]:
        """The scales in fragments `(R, width)`, (R, scales of a fragment): none but of 8-bit steps."""
        if not self._form.scaled:
            return np.zeros((len(rows), 0), dtype=_FLOAT32)
        return np.ascontiguousarray(rows[:, self._end :]).view(_FLOAT32)

    def check(self, source: np.ndarray, rows: np.ndarray) -> None:
        """Validates size and numbers of fragments of the UAVs `source` (R,) that come by network.

        Raises:
            MessageRejected: `wrong-shape`.
        """
        expect("payload", rows, (len(source), self.width), _BYTE)
        numbers = self.numbers(rows)
        if (numbers >= self.count).any():
            raise MessageRejected("wrong-shape", f"payload: fragment {numbers.max()} of {self.count}")
        place = source.astype(np.int64) * self.count + numbers
        if (place[1:] <= place[:-1]).any():
            raise MessageRejected("wrong-shape", "payload: fragments are not ascending, or one comes twice")


def pieces_of(parts: tuple[int, ...], size: int) -> tuple[int, ...]:
    """Sizes of the pieces into which the ends of parts and the ends of fragments of `size` weights cut a model."""
    return tuple(np.diff(_starts(parts, size), append=sum(parts)).tolist())


def cut_of(scenario: Scenario, parts: tuple[int, ...], bits: int, forms: Iterable[CodingForm]) -> Cut | None:
    """The cut of a scenario's models, the longest of which have so many bits; None: they go whole.

    Args:
        forms: of all models that it transmits.

    Raises:
        BadInput: the channel is not installed, or its options do not fit.
        ValueError: the channel fails, or a fragment has no room for a weight.
    """
    slots = scenario.federation.fragment
    if slots is None:
        slots = WHOLE if _fits(scenario, bits) else longest(scenario)
    if slots == WHOLE:
        return None
    radio = scenario.radio
    size = min(form.weights(int(slots * radio.bits_per_slot / 8), parts) for form in forms)
    if size < 1:
        raise ValueError(f"a fragment of {slots} slots has no room for a weight; set a larger `federation.fragment`")
    busy = radio.latency_threshold_slots * radio.coherence_time_s
    return None if size >= sum(parts) else Cut(slots, size, max(1, int(scenario.dt / busy * (1.0 + 1e-9))))


def longest(scenario: Scenario) -> int:
    """Slots of the longest fragments of which 95 % are expected to be delivered, at least 1.

    The expectation is that of the links between the leader's UAV and all others at take-off. A channel without closed
    forms gets a quarter of the latency threshold.

    Raises:
        BadInput: the channel is not installed, or its options do not fit.
        ValueError: the channel fails.
    """
    radio, distance = scenario.radio, _distances(scenario)
    for slots in range(radio.latency_threshold_slots, 0, -1):
        lost = _expected_losses(scenario, distance, int(slots * radio.bits_per_slot / 8) * 8)
        if lost is None:
            return max(1, radio.latency_threshold_slots // 4)
        if lost <= (1.0 - SUCCESS) * len(distance):
            return slots
    return 1


def _distances(scenario: Scenario) -> Floats:
    """Distances of all UAVs from the leader's at take-off, without its own, m."""
    places, leader = state.position(starts(scenario)), scenario.federation.leader
    return np.asarray(np.linalg.norm(np.delete(places, leader, axis=0) - places[leader], axis=-1))


def _expected_losses(scenario: Scenario, distance: Floats, bits: int) -> float | None:
    """Expected losses of a message of so many bits on links of lengths `distance` (K,), m; None if unknown.

    Raises as `longest`.
    """
    radio = scenario.radio
    channel = plugins.create("channel", radio.model, radio.options, scenario)
    try:
        expected = channel.expected(distance, bits) if len(distance) else (0.0, 0.0)
    except FAILURES as error:
        raise ValueError(f"channel {radio.model!r}: failed: {last_line(error)}") from error
    return None if expected is None else float(expected[0])


def share_delivered(scenario: Scenario, bits: int) -> float:
    """Expected share of messages of so many bits that are delivered to the leader's UAV at take-off; 1 if unknown.

    Raises:
        BadInput: the channel is not installed, or its options do not fit.
        ValueError: the channel fails.
    """
    distance = _distances(scenario)
    lost = _expected_losses(scenario, distance, bits)
    return 1.0 if lost is None or not len(distance) else 1.0 - lost / len(distance)


def _fits(scenario: Scenario, bits: int) -> bool:
    """Returns whether a message of so many bits can arrive within the latency threshold, or without a loss in a hop.

    A channel that does not say how long a message takes is taken to be fast enough. Raises as `longest`.
    """
    radio = scenario.radio
    channel = plugins.create("channel", radio.model, radio.options, scenario)
    try:
        least = channel.least_slots(bits)
        if least is None or least <= radio.latency_threshold_slots:
            return True
    except FAILURES as error:
        raise ValueError(f"channel {radio.model!r}: failed: {last_line(error)}") from error
    in_time = int(scenario.delivery_ticks(np.array(least))) <= scenario.hop_ticks
    return in_time and _expected_losses(scenario, np.ones(1), bits) == 0.0


def _keep_freed_blocks() -> None:
    """Lets glibc keep blocks of up to 32 MiB when they are freed, because the tables of long models come and go.

    It adapts its limits to the largest block that was freed. This one is never written to, so it takes no memory. Else
    the system clears the pages of these tables anew in every round, which takes a third of its time.
    """
    np.empty(_KEPT, dtype=_BYTE)


def _most_pieces(parts: tuple[int, ...], size: int) -> int:
    """The most pieces that one fragment has."""
    return int(np.bincount(_starts(parts, size) // size).max())


def _starts(parts: tuple[int, ...], size: int) -> NDArray[np.intp]:
    """First weights of all pieces, ascending."""
    return np.union1d(np.cumsum((0, *parts[:-1])), np.arange(0, sum(parts), size))
