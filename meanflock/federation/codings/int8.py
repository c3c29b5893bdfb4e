"""8-bit steps with a scale for each piece of the model."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.codings.base import COARSEST, Coding, Models
from meanflock.swarm.state import Floats, Mask

STEPS = 127  # of a scale, each way; −128 is never sent


class Int8(Coding):
    """A number is −127 … 127 steps of its piece's scale.

    The scale is the piece's largest number / 127, rounded up, so that no number is off by more than half a step.
    Numbers below half of the finest scale become 0.
    """

    name = "int8"
    bits = 8
    largest = STEPS * COARSEST

    def encode(self, models: Models) -> tuple[NDArray[Any], NDArray[np.float32]]:
        scales = models.scales(models.largest / STEPS)
        return np.rint(models.numbers / models.spread(scales)).astype(np.int8), scales

    def decode(self, numbers: NDArray[Any], scales: Floats) -> Floats:
        return numbers * scales

    def valid(self, numbers: NDArray[Any]) -> Mask:
        return np.asarray(numbers >= -STEPS)
