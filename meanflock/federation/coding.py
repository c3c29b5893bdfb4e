"""The coding of a codec: a plug-in, whose declarations and answers are validated here."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.codings.base import Coding, Models
from meanflock.swarm.errors import FAILURES, BadInput, PluginFailed, last_line
from meanflock.swarm.plugins.guard import check_array, check_values
from meanflock.swarm.state import Floats, Mask


def check_form(coding: Coding) -> None:
    """Raises BadInput if a coding declares `bits` or `largest` of which no messages can be made."""
    kind, widths = ("floats", (16, 32, 64)) if coding.floats else ("integers", (1, 2, 4, 8))
    if coding.bits not in widths:
        raise BadInput(f"coding {coding.name!r}: `bits` is {coding.bits!r}; of {kind} expected one of {widths}")
    if not (isinstance(coding.largest, Real) and 0.0 < coding.largest < math.inf):
        raise BadInput(
            f"coding {coding.name!r}: `largest` is {coding.largest!r}; expected a finite number greater than 0"
        )


class CheckedCoding:
    """A coding whose answers are checked; see `Coding` for the methods.

    Each raises PluginFailed if the coding raised, or returned something else than it must.
    """

    def __init__(self, coding: Coding) -> None:
        self.floats, self.scaled, self._bits, self._coding = coding.floats, coding.scaled, coding.bits, coding
        width = f"<f{coding.bits // 8}" if coding.floats else "i1" if coding.bits == 8 else "u1"
        self.dtype: np.dtype[Any] = np.dtype(width)  # of numbers

    def encode(self, models: Models) -> tuple[NDArray[Any], NDArray[np.float32]]:
        """The numbers (S, L) and the scales (S, P) of models."""
        with self._reported("encode"), np.errstate(all="ignore"):
            numbers, scales = check_values("encode", self._coding.encode(models), 2, "numbers and scales")
            check_array("numbers", numbers, models.numbers.shape, self.dtype)
            check_array("scales", scales, (len(models.numbers), len(models.starts) * self.scaled), np.float32)
            if self._bits < 8 and (largest := int(numbers.max(initial=0))) >> self._bits:
                raise ValueError(f"a number is {largest}; of {self._bits} bits expected numbers below {2**self._bits}")
        return numbers, scales

    def decode(self, numbers: NDArray[Any], scales: Floats) -> Floats:
        """The weights (R, n) that numbers (R, n) stand for."""
        with self._reported("decode"):
            weights = self._coding.decode(numbers, scales)
            check_array("weights", weights, numbers.shape, np.float64)
            if not np.isfinite(weights).all() and np.isfinite(numbers).all() and np.isfinite(scales).all():
                raise ValueError("the weights of finite numbers and scales are not finite")
        return weights

    def valid(self, numbers: NDArray[Any]) -> Mask:
        """The mask (R, n) of the numbers that the coding ever writes."""
        with self._reported("valid"):
            mask = self._coding.valid(numbers)
            check_array("mask", mask, numbers.shape, np.bool_)
        return mask

    @contextmanager
    def _reported(self, method: str) -> Iterator[None]:
        """Context in which an error ends the run, and names the coding."""
        try:
            yield
        except FAILURES as error:
            raise PluginFailed(f"coding {self._coding.name!r}: `{method}` failed: {last_line(error)}") from error
