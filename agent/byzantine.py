"""UAVs that upload falsehoods, for scenarios that ask what the federation withstands. They fly and learn honestly."""

import numpy as np
from numpy.typing import NDArray

from swarm.scenario import Scenario
from swarm.seeds import generator

HUGE = 1e30  # or half of the largest number the radio's floats can hold
BOOST = (
    100.0  # times the honest model, with the sign turned: large enough to own a mean, small enough to pass for a model
)
NOISE = 10.0  # standard deviation of false noise, in root-mean-square weights of the honest model


class Byzantine:
    """Which UAVs of a scenario are false, and what they say instead of their model."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        others = np.delete(np.arange(scenario.uavs), scenario.federation.leader)  # who averages has no need to lie
        count = min(len(others), round(scenario.federation.byzantine_fraction * scenario.uavs))
        draw = generator(scenario.seed, "byzantine")
        self.uavs = np.sort(draw.choice(others, count, replace=False)) if count else others[:0]

    def distort(self, number: int, uavs: NDArray[np.integer], payload: NDArray[np.floating]) -> NDArray[np.floating]:
        """The uploads `(S, L)` of `uavs` (S,) in a round, those of false ones replaced; same dtype and shape."""
        false = np.isin(uavs, self.uavs)
        if not false.any():
            return payload
        said = payload.copy()
        match self._scenario.federation.byzantine_kind:
            case "huge":
                largest = min(HUGE, float(np.finfo(payload.dtype).max) / 2)
                said[false] = np.where(payload[false] < 0, -largest, largest)
            case "sign-flip":
                said[false] = -payload[false]
            case "boost":
                largest = float(np.finfo(payload.dtype).max) / 2
                wide = -BOOST * payload[false].astype(np.float64)
                said[false] = np.clip(wide, -largest, largest).astype(payload.dtype)
            case "noise":
                for row in np.flatnonzero(false):
                    said[row] = self._noisy(number, int(uavs[row]), payload[row])
        return said

    def _noisy(self, number: int, uav: int, honest: NDArray[np.floating]) -> NDArray[np.floating]:
        draw = generator(self._scenario.seed, "byzantine", 1 + number * self._scenario.uavs + uav)
        wide = honest.astype(np.float64)
        noise = NOISE * np.sqrt((wide * wide).mean()) * draw.standard_normal(len(wide))
        limit = float(np.finfo(honest.dtype).max) / 2
        return np.clip(wide + noise, -limit, limit).astype(honest.dtype)
