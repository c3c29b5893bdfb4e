"""The radio of a tick, compiled. Where no compiler was at hand when meanflock was installed, it is NumPy's.

Both give the same bits. Most slots of a message are for few links, and a dozen calls of NumPy in each were all it cost.
"""

import numpy as np
from numpy.typing import NDArray

from channel.fading import Fading
from swarm import state

try:
    from channel import _kernel
except ImportError:
    _kernel = None  # type: ignore[assignment]

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]


def is_compiled() -> bool:
    """Whether this installation has the compiled form."""
    return _kernel is not None


def carry(fading: Fading, threshold: Floats, links: int, needed: int, slots_at_most: int) -> tuple[Counts, Counts]:
    """What `link.transmit` says of a message, from its first slot to its last; `threshold`: (K,), or (1,) for all."""
    slots, missing = np.empty(links, dtype=np.int64), np.empty(links, dtype=np.int64)
    busy, begun = links, False
    while busy:
        ahead = fading.ahead(busy)
        used, busy = _kernel.carry(
            ahead, fading.xi, fading.chi, threshold, needed, slots_at_most, begun, slots, missing
        )
        fading.use(used)
        begun = True
    return slots, missing


def account(
    template: NDArray[np.int32], tick: int, slots: Counts, missing: Counts, first: NDArray[np.intp]
) -> tuple[NDArray[np.int32], int, int, int]:
    """What `account.Account` says of a batch."""
    record = np.empty_like(template)
    return record, *_kernel.account(template, tick, slots, missing, first, record)


def within(states: state.States, diagonal_squared: float) -> bool:
    """Whether a box around all positions has no longer diagonal."""
    return _kernel.within(np.ascontiguousarray(states), diagonal_squared)
