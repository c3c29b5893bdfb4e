"""How a model is written on the radio: as floats of a width, or as 8-bit steps with a scale for each of its parts.

A row of a payload is what is transmitted, to the bit: L floats, or a byte for each of L weights and then the scales of
the parts that the controller declares as float32. A weight is −127 … 127 steps of its part's
scale; the scale is the part's largest weight / 127, rounded up, so that no weight is off by more than half a step.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.model import BEYOND_SENSE
from meanflock.swarm.scenario import Payload, Scenario
from meanflock.swarm.state import Floats
from meanflock.swarm.wire.control import FLOAT_OF_BITS, expect

STEPS = 127  # of a scale, each way; −128 is never sent
FINEST = float(np.finfo(np.float32).tiny)  # a scale below would be imprecise; weights below half of it become 0
COARSEST = BEYOND_SENSE

_SCALE, _BYTE = np.dtype("<f4"), np.dtype("u1")
_FLOATS = {f"float{bits}": dtype for bits, dtype in FLOAT_OF_BITS.items()}


class Coding:
    """One way to write what a method shares. Rows are independent, to the last bit."""

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

    def check(self, payload: np.ndarray, rows: int) -> None:
        """Lets through what came by network as the payloads of so many models.

        Raises:
            MessageRejected: `wrong-shape` or `non-finite`.
        """
        expect("payload", payload, (rows, self.width), self.dtype)
        if not self.sound(payload).all():
            raise MessageRejected("non-finite", "payload: steps or scales beyond all bounds")

    def _halves(self, payload: np.ndarray) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
        """Steps `(S, L)` and scales `(S, parts)`."""
        return payload[:, : self.floats].view(np.int8), np.ascontiguousarray(payload[:, self.floats :]).view(_SCALE)

    def _spread(self, scales: NDArray[np.float32]) -> Floats:
        """The scale of every weight, `(S, L)`."""
        return np.repeat(scales, self._sizes, axis=-1).astype(np.float64)


_coding = cache(Coding)


def upload(scenario: Scenario) -> Coding:
    """How a scenario's uploads are written."""
    return _coding(scenario.upload_payload, scenario.declared.parts)


def broadcast(scenario: Scenario) -> Coding:
    """How a scenario's global models are written."""
    return _coding(scenario.broadcast_payload, scenario.declared.parts)
