"""Whether a state that somebody broadcast is one that a UAV can have: a lie beyond it is not believed."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import POSITION, VELOCITY


def check(scenario: Scenario) -> Callable[[NDArray[np.float64]], NDArray[np.bool_]]:
    """Returns a function from states (S, 4) to which of them can be, (S,).

    No UAV is faster than `radio.plausible_speed`, nor farther from the origin than any can have come from its start at
    that speed.
    """
    speed = scenario.radio.plausible_speed
    farthest = float(np.hypot(*starts(scenario)[:, POSITION].T).max())
    reach = farthest + speed * scenario.duration

    def can_be(states: NDArray[np.float64]) -> NDArray[np.bool_]:
        numbers = states.astype(np.float64, copy=False)  # of whole numbers the square may not fit in as many bits
        squared = numbers * numbers
        position, velocity = squared[:, POSITION].sum(axis=-1), squared[:, VELOCITY].sum(axis=-1)
        sane: NDArray[np.bool_] = (position <= reach * reach) & (velocity <= speed * speed)
        return sane

    return can_be
