"""Base class of codings: how the numbers of a model are written on the radio.

A coding writes each number in the same few bits. Where it is `scaled`, each piece of a model has one float32 beside
these, its scale. A piece is a part that the controller declares, or what of it lies in one fragment.
"""

from abc import abstractmethod
from typing import Any, ClassVar, Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import BEYOND_SENSE, Floats, Mask

FINEST = float(np.finfo(np.float32).tiny)  # least scale: one below would be imprecise
COARSEST = BEYOND_SENSE  # largest scale


class Models(NamedTuple):
    """Models that are to be written, S of them.

    numbers: (S, L), any float64. starts: (P,), first numbers of the pieces, ascending. uavs: (S,), the UAVs that send.
    round: number of the round.
    """

    numbers: Floats
    starts: NDArray[np.intp]
    uavs: NDArray[np.integer]
    round: int

    @property
    def largest(self) -> Floats:
        """Size of the largest number of every piece, (S, P)."""
        return np.asarray(np.maximum.reduceat(np.abs(self.numbers), self.starts, axis=-1))

    @property
    def mean_size(self) -> Floats:
        """Mean size of the numbers of every piece, (S, P)."""
        sizes = np.diff(self.starts, append=self.numbers.shape[1])
        return np.asarray(np.add.reduceat(np.abs(self.numbers), self.starts, axis=-1) / sizes)

    @staticmethod
    def scales(sizes: Floats) -> NDArray[np.float32]:
        """Scales (S, P) as float32, rounded up, so that none is smaller than in float64; at least `FINEST`."""
        scales = sizes.astype(np.float32)
        scales = np.where(scales < sizes, np.nextafter(scales, np.float32(np.inf)), scales)
        return np.maximum(scales, np.float32(FINEST)).astype(np.float32)

    def spread(self, scales: NDArray[np.floating]) -> Floats:
        """The scale of every number, (S, L), of the scales (S, P) of the pieces."""
        sizes = np.diff(self.starts, append=self.numbers.shape[1])
        return np.repeat(scales, sizes, axis=-1).astype(np.float64)


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base class of a coding's options: derive from it and add annotated fields with defaults."""


class Coding:
    """Base class of codings; override `encode` and `decode`. A row of its tables depends on its own model alone.

    A coding that raises or returns something else in flight ends the run: exit code 1, and a line that names it.
    """

    plugin_kind: ClassVar[Literal["coding"]] = "coding"
    name: ClassVar[str] = ""  # value of `federation.payload` and `federation.broadcast_payload`
    Options: ClassVar[type[msgspec.Struct]] = Options
    bits: ClassVar[int] = 8  # of a number on the radio: 1, 2, 4 or 8; of floats 16, 32 or 64
    floats: ClassVar[bool] = False  # numbers are floats of so many bits; else integers
    scaled: ClassVar[bool] = True  # whether each piece has a scale
    largest: ClassVar[float] = COARSEST  # largest number of a model that can be written

    def __init__(self, options: Any, scenario: Scenario) -> None:
        """`options`: an instance of `Options`."""
        self.options, self.scenario = options, scenario

    @abstractmethod
    def encode(self, models: Models) -> tuple[NDArray[Any], NDArray[np.float32]]:
        """Returns the numbers to send, (S, L), and the scales of the pieces, (S, P), or (S, 0) without scales.

        Numbers are floats; or integers: of 8 bits int8, of fewer bits uint8 below 2^bits. A model that has numbers
        beyond all bounds, or NaN, gets numbers or scales that are not `valid`.

        Args:
            models: `models.numbers` (S, L), any float64; `models.starts` (P,), first numbers of the pieces, ascending;
                `models.uavs` (S,), the UAVs that send; `models.round`, number of the round. `models.largest` and
                `models.mean_size` (S, P) are sizes of the numbers of every piece, `models.scales(sizes)` makes scales
                of sizes, and `models.spread(scales)` (S, L) has the scale of every number.
        """
        raise NotImplementedError

    @abstractmethod
    def decode(self, numbers: NDArray[Any], scales: Floats) -> Floats:
        """Returns the weights (R, n) that numbers (R, n) stand for; `scales` (R, n): the scale of each; without scales
        (R, 0)."""
        raise NotImplementedError

    def valid(self, numbers: NDArray[Any]) -> Mask:
        """Returns the mask (R, n) of the numbers that this coding ever writes."""
        return np.isfinite(numbers) if self.floats else np.ones(numbers.shape, dtype=bool)
