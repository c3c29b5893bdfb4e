"""Floats of 16, 32 and 64 bits, written as they are."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.codings.base import Coding, Models
from meanflock.swarm.state import Floats


class Float64(Coding):
    """Floats of 64 bits."""

    name = "float64"
    bits = 64
    floats = True
    scaled = False
    largest = float(np.finfo(np.float64).max)

    def encode(self, models: Models) -> tuple[NDArray[Any], NDArray[np.float32]]:
        return models.numbers.astype(f"<f{self.bits // 8}"), np.zeros((len(models.numbers), 0), dtype=np.float32)

    def decode(self, numbers: NDArray[Any], scales: Floats) -> Floats:
        return numbers.astype(np.float64)


class Float32(Float64):
    """Floats of 32 bits."""

    name = "float32"
    bits = 32
    largest = float(np.finfo(np.float32).max)


class Float16(Float64):
    """Floats of 16 bits."""

    name = "float16"
    bits = 16
    largest = float(np.finfo(np.float16).max)
