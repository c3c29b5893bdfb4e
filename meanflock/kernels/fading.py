"""Fading: the slots of a message on each link, and the sums of Poisson terms in the tail of the amplitude."""

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.state import Floats


def fade(
    normal: Floats,
    xi: float,
    chi: float,
    thresholds: Floats,
    slot: int,
    busy: NDArray[np.intp],
    missing: NDArray[np.int64],
    slots: NDArray[np.int64],
) -> int:
    """Send for one slot over B of L links. A slot is good if z² = |ξ + χ(n₁ + jn₂)|² reaches the threshold.

    Args:
        normal: (B, 2), standard normal numbers n₁, n₂ of each busy link; may be overwritten.
        thresholds: of z²; (L,), or (1,) if all links have the same.
        slot: number of this slot.
        busy: (≥ B,), written: the first B are the busy links; then, in the same order, those that still are.
        missing: (L,), written: good slots that the message of a link still needs.
        slots: (L,), written: `slot` for the links that were busy.

    Returns:
        The number of links that are still busy.
    """
    links = busy[: len(normal)]
    good = _squared_amplitude(normal, xi, chi) >= (thresholds if len(thresholds) == 1 else thresholds.take(links))
    return _counted(good, slot, busy, missing, slots)


def send(
    uniform: Floats,
    success: Floats,
    slot: int,
    busy: NDArray[np.intp],
    missing: NDArray[np.int64],
    slots: NDArray[np.int64],
) -> int:
    """Send for one slot over B of L links, as `fade` does. A slot is good with a probability that is known.

    Args:
        uniform: (B,), drawn from [0, 1), one for each busy link. success: (L,), probability that a slot is good.
    """
    return _counted(uniform < success.take(busy[: len(uniform)]), slot, busy, missing, slots)


def _counted(
    good: NDArray[np.bool_], slot: int, busy: NDArray[np.intp], missing: NDArray[np.int64], slots: NDArray[np.int64]
) -> int:
    links = busy[: len(good)]
    left = missing.take(links)
    left -= good
    missing[links] = left
    slots[links] = slot
    still = links.take(left.nonzero()[0])
    busy[: len(still)] = still
    return len(still)


def _squared_amplitude(normal: Floats, xi: float, chi: float) -> Floats:
    """z² = |ξ + χ(n₁ + jn₂)|² of standard normal numbers (K, 2), which are overwritten; (K,)."""
    normal *= chi
    normal[:, 0] += xi
    normal *= normal
    return normal[:, 0] + normal[:, 1]


def poisson(rates: Floats, first: Floats, terms: int, reached: Floats, sums: Floats) -> None:
    """Write Σ_{k=0}^{terms} `reached[first + k]` Π_{j=1}^{k} rate/(first + j) of each rate to `sums`, by Horner's rule.

    Args:
        rates: (K,). first: (K,), whole numbers. reached: (R,); its last number stands for all after it. sums: (K,).
    """
    sums[:] = 0.0
    if first.any():
        index = first.astype(np.intp)
        for k in range(terms, -1, -1):
            sums *= rates / (first + (k + 1.0))
            sums += reached.take(index + k, mode="clip")
    else:
        for k in range(terms, -1, -1):
            sums *= rates / (k + 1.0)
            sums += reached[min(k, len(reached) - 1)]
