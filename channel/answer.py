"""What a channel, which may be anybody's, answers: checked here, for the medium and for the conformance suite."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.failures import FAILURES

MOST_SLOTS = 1_000_000  # a message may take


def carried(answer: Any, links: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Slots and delivered of so many links, if they are what `transmit` must return.

    Raises:
        TypeError, ValueError: they are not.
    """
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise TypeError(f"`transmit` returns a {type(answer).__name__}; expected slots and delivered")
    for name, array, dtype in zip(("slots", "delivered"), answer, (np.int64, np.bool_), strict=True):
        if not isinstance(array, np.ndarray) or array.shape != (links,) or array.dtype != dtype:
            found = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
            raise TypeError(f"{name}: {found}, expected {np.dtype(dtype)} {(links,)}")
    slots, delivered = answer
    least, most = (np.minimum.reduce(slots), np.maximum.reduce(slots)) if links else (1, 1)
    if least < 1 or most > MOST_SLOTS:
        raise ValueError(f"slots from {least} to {most}; a message takes 1 to {MOST_SLOTS}")
    return slots, delivered


def closed_form(answer: Any) -> tuple[float, float] | None:
    """Outages and slots, if they are what `expected` must return; None where that is not known.

    Raises:
        ValueError: they are not.
    """
    if answer is None:
        return None
    try:
        outages, slots = map(float, answer)
    except FAILURES:
        outages = slots = math.nan
    if not math.isfinite(outages + slots):
        raise ValueError(f"`expected` returns {answer!r}; expected two finite numbers, or None where unknown")
    return outages, slots
