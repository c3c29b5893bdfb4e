"""Coding of models on the radio: floats of a width, or 8-bit steps with a scale for each part of the model.

A row of a payload is what is transmitted, to the bit: L floats, or a byte for each of L weights and then the scales of
the parts that the controller declares as float32. A weight is −127 … 127 steps of its part's
scale; the scale is the part's largest weight / 127, rounded up, so that no weight is off by more than half a step.

A model that is too long for one message is transmitted in fragments (`federation/fragments.py`). A node hands whole
payloads to the world all the same; what arrives at a node is in fragments.
"""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.fragments import CodingForm, Cut, Fragments, Pieces, cut_of, pieces_of
from meanflock.swarm.declared import Declared
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Payload, Scenario
from meanflock.swarm.state import BEYOND_SENSE, Floats, Mask
from meanflock.swarm.wire.control import FLOAT_OF_BITS, expect

STEPS = 127  # of a scale, each way; −128 is never sent
FINEST = float(np.finfo(np.float32).tiny)  # a scale below would be imprecise; weights below half of it become 0
COARSEST = BEYOND_SENSE

_FLOAT32, _BYTE = np.dtype("<f4"), np.dtype("u1")
_FLOATS = {f"float{bits}": dtype for bits, dtype in FLOAT_OF_BITS.items()}


class Coding:
    """One way to write models. Rows are independent, to the last bit.

    Attributes:
        floats: L, weights of a model.
        dtype, width: of a row of a payload.
        largest: number that a weight can be.
        held: dtype in which a receiver holds weights: that of floats on the air, float64 for steps of scales.
        cut: how the scenario cuts models; None: it does not.
        form: what a fragment holds.
        fragments: how payloads are cut on the air; None: each is one message.
    """

    counted = False  # whether payloads say how many models each is the mean of

    def __init__(
        self, name: Payload, parts: tuple[int, ...], cut: Cut | None = None, *, weighted: bool = False
    ) -> None:
        """
        Args:
            name: number format.
            parts: sizes of the parts of a model.
            cut: how the scenario cuts models.
            weighted: each payload ends with the weight that its sender declares, a float32; an average with the sum of
                these weights, in each of its fragments.
        """
        self.floats = sum(parts)
        self.is_exact = name in _FLOATS  # but for the width of its floats
        self.weighted = weighted
        self.cut = cut
        self._item = _FLOATS.get(name, _BYTE)
        self.held = self._item if self.is_exact else np.dtype(np.float64)
        self.largest = _largest(name)
        self._sizes = parts if self.is_exact or cut is None else pieces_of(parts, cut.size)
        self._starts = np.cumsum((0, *self._sizes[:-1]))
        self.form = CodingForm(self._item, self.counted, weighted, scaled=not self.is_exact)
        self.fragments = None if cut is None else Fragments(cut, self.floats, self._starts, self.form)
        self.count = 1 if self.fragments is None else self.fragments.count  # F
        numbers = self.floats + self.count * self.counted  # of the dtype `item`, in a row
        if not self.is_exact:
            numbers += _FLOAT32.itemsize * len(self._sizes)
        self._weights = self.count if self.counted else 1  # of a row, if it has any
        self.width = numbers * self._item.itemsize + _FLOAT32.itemsize * self._weights if weighted else numbers
        self.dtype = _BYTE if weighted else self._item

    @property
    def ticks(self) -> int:
        """Ticks in which a model is transmitted."""
        return 1 if self.fragments is None else self.fragments.ticks

    @property
    def bits(self) -> int:
        """Bits of a whole payload that are transmitted and billed, the scales included."""
        return 8 * self.dtype.itemsize * self.width

    def encode(self, models: Floats) -> np.ndarray:
        """Models `(S, L)` as numbers `(S, …)` for `pack`; `valid` says which of them can be sent."""
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            if self.is_exact:
                return models.astype(self._item)
            step = np.maximum.reduceat(np.abs(models), self._starts, axis=-1) / STEPS
            scales = step.astype(_FLOAT32)
            scales = np.where(scales < step, np.nextafter(scales, np.float32(np.inf)), scales)
            scales = np.maximum(scales, np.float32(FINEST)).astype(_FLOAT32)
            steps = np.rint(models / self._spread(scales)).astype(np.int8)
        return np.concatenate([steps.view(_BYTE), scales.view(_BYTE)], axis=-1)

    def decode(self, numbers: np.ndarray) -> Floats:
        """The models `(S, L)` in valid numbers of `encode`."""
        if self.is_exact:
            return numbers.astype(np.float64)
        steps, scales = self._halves(numbers)
        return steps * self._spread(scales)

    def valid(self, numbers: np.ndarray) -> NDArray[np.bool_]:
        """Mask `(S,)` of models that can be sent and read: floats that are finite, steps and scales within bounds."""
        if self.is_exact:
            return np.asarray(np.isfinite(numbers).all(axis=-1))
        steps, scales = self._halves(numbers)
        bounded = ((scales >= FINEST) & (scales <= COARSEST)).all(axis=-1)
        return np.asarray(bounded & (steps >= -STEPS).all(axis=-1))

    def pack(self, numbers: np.ndarray, weights: Floats) -> np.ndarray:
        """Payloads `(S, width)` of numbers of `encode`, with the declared weights (S, K) if the coding has them.

        K is 1; for averages it is F.
        """
        if not self.weighted:
            return numbers
        return np.concatenate([_bytes_of(numbers), _bytes_of(weights.astype(_FLOAT32))], axis=-1)

    def unpack(self, payload: np.ndarray) -> tuple[np.ndarray, Floats]:
        """The numbers of `encode` in payloads `(S, width)`, and the declared weights (S, K); 1 where there are none."""
        if not self.weighted:
            return payload, np.ones((len(payload), self._weights))
        end = -_FLOAT32.itemsize * self._weights
        numbers = np.ascontiguousarray(payload[:, :end]).view(self._item)
        return numbers, np.ascontiguousarray(payload[:, end:]).view(_FLOAT32).astype(np.float64)

    def write(self, models: Floats, weights: Floats, behind: Floats) -> np.ndarray:
        """Averages `(S, L)` as payloads `(S, width)`.

        Args:
            models: the averages.
            weights: (S, F) sum of the weights of the models behind each of their fragments.
            behind: (S, F) number of these models.
        """
        return self.pack(self.encode(models), np.ones((len(models), 1)))

    def on_air(self, payload: np.ndarray, turn: slice = slice(None)) -> NDArray[np.uint8]:
        """The fragments `(S, T, …)` of payloads `(S, width)` whose numbers are in `turn`; all F where left out."""
        assert self.fragments is not None
        return self.fragments.rows(*self.unpack(payload), turn)

    def received(self, rows: np.ndarray) -> Pieces:
        """Contents of rows `(R, …)` that passed `check_received`: fragments; a whole model counts as one fragment.

        Without declared weights an average counts as many times as it has models.
        """
        if self.fragments is not None:
            return self.fragments.read(rows)
        numbers, weights = self.unpack(rows)
        values = numbers[:, : self.floats] if self.is_exact else self.decode(numbers)
        behind = self.behind(numbers)
        counts = weights if self.weighted else behind
        return Pieces(np.zeros(len(rows), dtype=np.intp), values, counts[:, 0], behind[:, 0])

    def check(self, source: np.ndarray, payload: np.ndarray) -> None:
        """Validates whole payloads of the UAVs `source` (S,) that come by network.

        The reader of the message refuses floats that are not finite; here bytes are looked into.

        Raises:
            MessageRejected: `wrong-shape` or `non-finite`.
        """
        expect("payload", payload, (len(source), self.width), self.dtype)
        numbers, weights = self.unpack(payload)
        behind = self.behind(numbers)
        self._check_weights(weights, behind)
        if self.dtype == _BYTE and not self.valid(numbers).all():
            raise MessageRejected("non-finite", "payload: steps or scales beyond all bounds")
        # A fragment that nobody sent is the mean of no model; where models are not cut, that is not sent at all.
        self._check_behind(source, behind, 1 if self.fragments is None else 0)

    def check_received(self, source: np.ndarray, rows: np.ndarray) -> None:
        """Validates what arrived from the UAVs `source` (R,): fragments, or whole payloads.

        Raises:
            MessageRejected: `wrong-shape` or `non-finite`.
        """
        if self.fragments is None:
            self.check(source, rows)
            return
        self.fragments.check(source, rows)
        behind = self.fragments.behind(rows)
        self._check_weights(self.fragments.weights(rows), behind)
        scales = self.fragments.scales(rows)
        if not (self.fragments.is_valid(rows) and ((scales >= FINEST) & (scales <= COARSEST)).all()):
            raise MessageRejected("non-finite", "payload: a fragment is beyond all bounds")
        self._check_behind(source, behind[:, None], 1)

    def behind(self, numbers: np.ndarray) -> Floats:
        """The number of models behind each of the weights that payloads with these numbers have, (S, K)."""
        return np.ones((len(numbers), 1))

    def _check_behind(self, source: np.ndarray, behind: Floats, least: int) -> None:
        """Validates the numbers of models (S, K) behind payloads of the UAVs `source` (S,), each at least `least`."""

    def _check_weights(self, weights: Floats, behind: Floats) -> None:
        """Validates declared weights, or their sums, of so many models each.

        Raises:
            MessageRejected: `wrong-shape`.
        """
        if self.weighted and not np.where(behind > 0.0, _are_weights(weights, behind), weights == 0.0).all():
            raise MessageRejected("wrong-shape", "payload: weights of models that are not positive numbers")

    def _halves(self, numbers: np.ndarray) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
        """Steps `(S, L)` and scales `(S, parts)`."""
        return numbers[:, : self.floats].view(np.int8), np.ascontiguousarray(numbers[:, self.floats :]).view(_FLOAT32)

    def _spread(self, scales: NDArray[np.float32]) -> Floats:
        """The scale of every weight, `(S, L)`."""
        return np.repeat(scales, self._sizes, axis=-1).astype(np.float64)


def _largest(name: Payload) -> float:
    """Largest number that a weight can be in a number format."""
    return float(np.finfo(_FLOATS[name]).max) if name in _FLOATS else STEPS * COARSEST


def check_weights(label: str, weights: Floats) -> None:
    """Check that a radio can carry declared weights: as float32 they are greater than 0 and not beyond all bounds.

    Raises:
        ValueError: it cannot carry one; the text has it.
    """
    with np.errstate(over="ignore", under="ignore"):
        carried = _are_weights(weights.astype(_FLOAT32).astype(np.float64), 1.0)
    if not carried.all():
        expected = "a weight is sent as float32, so expected numbers greater than 0, from 1e-45 to 1e30"
        raise ValueError(f"{label} has {weights[~carried][0]:g}; {expected}")


def _are_weights(weights: Floats, behind: Floats | float) -> Mask:
    """Mask of the numbers that are the sum of the weights of `behind` models."""
    return np.asarray((weights > 0.0) & (weights / COARSEST < behind))


def _bytes_of(table: np.ndarray) -> NDArray[np.uint8]:
    """The bytes of each row."""
    return np.ascontiguousarray(table).view(_BYTE)


class Counted(Coding):
    """Averages as floats of the radio, with the number of models behind each as one more float.

    The number is paid for like every weight. A coarser coding would lose what no later upload gives back. Each fragment
    has a number of its own, and if controllers declare weights, the sum of the weights of these models.
    """

    counted = True

    def __init__(
        self, name: Payload, parameters: int, most: NDArray[np.intp], cut: Cut | None = None, *, weighted: bool = False
    ) -> None:
        """`most`: (N,) models that an average of each UAV can stand for."""
        super().__init__(name, (parameters,), cut, weighted=weighted)
        self._most = most

    def write(self, models: Floats, weights: Floats, behind: Floats) -> np.ndarray:
        return self.pack(self.encode(np.concatenate([models, behind], axis=-1)), weights)

    def behind(self, numbers: np.ndarray) -> Floats:
        """See `Coding.behind`."""
        return numbers[:, self.floats :].astype(np.float64)

    def _check_behind(self, source: np.ndarray, behind: Floats, least: int) -> None:
        """Validates that no average stands for more models than its UAV can have.

        Raises:
            MessageRejected: `wrong-shape`.
        """
        if ((behind < least) | (behind > self._most[source][:, None]) | (np.floor(behind) != behind)).any():
            raise MessageRejected("wrong-shape", f"averages of {behind.tolist()} models")


_coding = cache(Coding)


def of_uploads(scenario: Scenario, declared: Declared, cut: Cut | None) -> Coding:
    """The coding of a scenario's uploads."""
    return _coding(scenario.upload_payload, declared.parts, cut, weighted=declared.weighted)


def of_relays(scenario: Scenario, declared: Declared, most: NDArray[np.intp], cut: Cut | None) -> Coding:
    """The coding of averages of `most` (N,) models at the most, which heads of clusters send."""
    return Counted(scenario.radio_payload, declared.parameters, most, cut, weighted=declared.weighted)


def of_broadcasts(scenario: Scenario, declared: Declared, cut: Cut | None) -> Coding:
    """The coding of a scenario's global models."""
    return _coding(scenario.broadcast_payload, declared.parts, cut)


def bound_of_models(scenario: Scenario) -> float:
    """Size that every weight of a model must be below, so that it can be sent."""
    return min(BEYOND_SENSE, math.nextafter(_largest(scenario.upload_payload), math.inf))


def cut_of_models(scenario: Scenario, declared: Declared) -> Cut | None:
    """The cut of a scenario's models, by the longest of them; None: they go whole. It may ask the channel, so ask once.

    Raises:
        BadInput: the channel is not installed, or its options do not fit.
        ValueError: the channel fails, or a fragment has no room for a weight.
    """
    parts, weighted = declared.parts, declared.weighted
    upload = _coding(scenario.upload_payload, parts, weighted=weighted)
    broadcast = _coding(scenario.broadcast_payload, parts)
    relay = Counted(scenario.radio_payload, sum(parts), np.ones(0, dtype=np.intp), weighted=weighted)
    sent = [upload, broadcast, relay] if scenario.federation.clusters > 1 else [upload, broadcast]
    return cut_of(scenario, parts, max(coding.bits for coding in sent), [coding.form for coding in sent])
