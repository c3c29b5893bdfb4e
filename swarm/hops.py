"""How long a message is on its way, in ticks, and how many hops a model takes."""

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from meanflock.swarm.scenario.tables import Radio


class Timed(Protocol):
    """What of a scenario decides it."""

    @property
    def dt(self) -> float:
        """A tick, s."""

    @property
    def radio(self) -> "Radio":
        """The link."""


HOPS = 2  # of a model where there are clusters: to the head, and on to the leader


def delivery_ticks(scenario: Timed, slots: NDArray[np.int64]) -> NDArray[np.intp]:
    """Ticks until a message that took so many slots is delivered: max(1, ⌈slots θ/dt⌉), same shape.

    A quotient that is a whole number but for rounding counts as that number.
    """
    ticks = slots * scenario.radio.coherence_time_s / scenario.dt
    return np.maximum(1, np.ceil(ticks * (1.0 - 1e-9))).astype(np.intp)
