"""Coding of models on the radio: floats of a width, or 8-bit steps with a scale for each part of the model.

A row of a payload is what is transmitted, to the bit: L floats, or a byte for each of L weights and then the scales of
the parts that the controller declares as float32. A weight is −127 … 127 steps of its part's
scale; the scale is the part's largest weight / 127, rounded up, so that no weight is off by more than half a step.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Payload, Scenario
from meanflock.swarm.state import BEYOND_SENSE, Floats
from meanflock.swarm.wire.control import FLOAT_OF_BITS, expect

STEPS = 127  # of a scale, each way; −128 is never sent
FINEST = float(np.finfo(np.float32).tiny)  # a scale below would be imprecise; weights below half of it become 0
COARSEST = BEYOND_SENSE

_SCALE, _BYTE = np.dtype("<f4"), np.dtype("u1")
_FLOATS = {f"float{bits}": dtype for bits, dtype in FLOAT_OF_BITS.items()}


class Coding:
    """One way to write models. Rows are independent, to the last bit."""

    def __init__(self, name: Payload, parts: tuple[int, ...]) -> None:
        """`parts`: sizes of the parts of a model."""
        self.floats = sum(parts)  # L
        self._sizes = parts
        self._starts = np.cumsum((0, *self._sizes[:-1]))
        self.is_exact = name in _FLOATS  # but for the width of its floats
        self.dtype = _FLOATS.get(name, _BYTE)
        self.width = self.floats if self.is_exact else self.floats + _SCALE.itemsize * len(self._sizes)
        self.largest = float(np.finfo(self.dtype).max) if self.is_exact else STEPS * COARSEST  # a weight can be

    @property
    def bits(self) -> int:
        """What a transmission pays for, the scales included."""
        return 8 * self.dtype.itemsize * self.width

    def encode(self, models: Floats) -> np.ndarray:
        """Models `(S, L)` as payloads `(S, width)`; `sound` says which of them can be sent."""
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            if self.is_exact:
                return models.astype(self.dtype)
            step = np.maximum.reduceat(np.abs(models), self._starts, axis=-1) / STEPS
            scales = step.astype(_SCALE)
            scales = np.where(scales < step, np.nextafter(scales, np.float32(np.inf)), scales)
            scales = np.maximum(scales, np.float32(FINEST)).astype(_SCALE)
            steps = np.rint(models / self._spread(scales)).astype(np.int8)
        return np.concatenate([steps.view(_BYTE), scales.view(_BYTE)], axis=-1)

    def decode(self, payload: np.ndarray) -> Floats:
        """The models `(S, L)` in sound payloads."""
        if self.is_exact:
            return payload.astype(np.float64)
        steps, scales = self._halves(payload)
        return steps * self._spread(scales)

    def sound(self, payload: np.ndarray) -> NDArray[np.bool_]:
        """Which payloads can be sent and read, `(S,)`: floats that are finite, steps and scales within bounds."""
        if self.is_exact:
            return np.asarray(np.isfinite(payload).all(axis=-1))
        steps, scales = self._halves(payload)
        bounded = ((scales >= FINEST) & (scales <= COARSEST)).all(axis=-1)
        return np.asarray(bounded & (steps >= -STEPS).all(axis=-1))

    def write(self, models: Floats, weights: Floats) -> np.ndarray:
        """Models `(S, L)`, each an average of `weights` (S,) models, as payloads `(S, width)`."""
        return self.encode(models)

    def read(self, payload: np.ndarray) -> tuple[Floats, Floats]:
        """The models `(S, L)` in sound payloads, and the numbers of models behind them `(S,)`."""
        return self.decode(payload), np.ones(len(payload))

    def check(self, source: np.ndarray, payload: np.ndarray) -> None:
        """Validates payloads of the UAVs `source` (S,) that come by network.

        Raises:
            MessageRejected: `wrong-shape` or `non-finite`.
        """
        expect("payload", payload, (len(source), self.width), self.dtype)
        if not self.sound(payload).all():
            raise MessageRejected("non-finite", "payload: steps or scales beyond all bounds")

    def _halves(self, payload: np.ndarray) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
        """Steps `(S, L)` and scales `(S, parts)`."""
        return payload[:, : self.floats].view(np.int8), np.ascontiguousarray(payload[:, self.floats :]).view(_SCALE)

    def _spread(self, scales: NDArray[np.float32]) -> Floats:
        """The scale of every weight, `(S, L)`."""
        return np.repeat(scales, self._sizes, axis=-1).astype(np.float64)


class Counted(Coding):
    """Averages as floats of the radio, with the number of models behind each as one more float.

    The number is paid for like every weight. A coarser coding would lose what no later upload gives back.
    """

    def __init__(self, name: Payload, parameters: int, most: NDArray[np.intp]) -> None:
        """`most`: (N,) models that an average of each UAV can stand for."""
        super().__init__(name, (parameters + 1,))
        self._most = most

    def write(self, models: Floats, weights: Floats) -> np.ndarray:
        """Averages `(S, L)` of `weights` (S,) models each, as payloads `(S, L + 1)`."""
        return self.encode(np.concatenate([models, weights[:, None]], axis=-1))

    def read(self, payload: np.ndarray) -> tuple[Floats, Floats]:
        """The models `(S, L)` in sound payloads, and the numbers of models behind them `(S,)`."""
        numbers = self.decode(payload)
        return numbers[:, :-1], numbers[:, -1]

    def check(self, source: np.ndarray, payload: np.ndarray) -> None:
        """Validates payloads that come by network, and that no average stands for more models than its UAV can have.

        Raises:
            MessageRejected: `wrong-shape` or `non-finite`.
        """
        super().check(source, payload)
        counts = payload[:, -1].astype(np.float64)
        if ((counts < 1) | (counts > self._most[source]) | (np.floor(counts) != counts)).any():
            raise MessageRejected("wrong-shape", f"averages of {counts.tolist()} models")


class Feedback:
    """Error feedback for M rows: what coding takes from an upload is added to the row's next upload.

    With w the model, e the residual and Q the coding, a UAV sends q = Q(w + e) and sets e ← w + e − q (Seide et al.
    2014; Karimireddy et al. 2019), so Σ q = Σ w − e. Whole models are sent: a lost upload costs at most one rounding.
    """

    def __init__(self, coding: Coding, rows: int, *, active: bool) -> None:
        self.residuals: Floats | None = np.zeros((rows, coding.floats)) if active else None  # (M, L)
        self._coding = coding

    def encode(self, rows: NDArray[np.intp], models: Floats) -> NDArray[np.generic]:
        """Payloads of `rows` (S,) for their `models` (S, L); a payload that cannot be sent leaves no residual.

        The residuals are replaced, never written to, so a caller may keep the earlier ones.
        """
        if self.residuals is None:
            return self._coding.encode(models)
        meant = models + self.residuals[rows]
        payload = self._coding.encode(meant)
        sound = self._coding.sound(payload)
        self.residuals = self.residuals.copy()
        self.residuals[rows[sound]] = meant[sound] - self._coding.decode(payload[sound])
        return payload


class Trigger:
    """Silence of M rows whose models have hardly moved: ‖w − w_sent‖ ≤ threshold · ‖w_sent‖.

    w is the model, and w_sent the one that the row sent last; the first model always goes. Global models that a UAV
    takes move w, too.
    """

    def __init__(self, threshold: float, rows: int, parameters: int) -> None:
        self._threshold = threshold
        self.sent = np.zeros((rows, parameters))  # (M, L); 0 where nothing was sent

    def due(self, rows: NDArray[np.intp], models: Floats) -> NDArray[np.bool_]:
        """Which of `rows` (S,) send their `models` (S, L), (S,); these count as sent.

        `sent` is replaced, never written to, so a caller may keep the earlier one.
        """
        before = self.sent[rows]
        moved, size = ((each * each).sum(axis=-1) for each in (models - before, before))
        due = np.asarray((moved > self._threshold**2 * size) | (size == 0.0))
        self.sent = self.sent.copy()
        self.sent[rows[due]] = models[due]
        return due


_coding = cache(Coding)


def of_uploads(scenario: Scenario) -> Coding:
    """The coding of a scenario's uploads."""
    return _coding(scenario.upload_payload, scenario.declared.parts)


def of_broadcasts(scenario: Scenario) -> Coding:
    """The coding of a scenario's global models."""
    return _coding(scenario.broadcast_payload, scenario.declared.parts)
