"""UAVs that upload falsehoods, for scenarios that ask what the federation withstands. They fly and learn honestly."""

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.codec import Codec, Coded
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import generator
from meanflock.swarm.state import contains

HUGE = 1e30  # or half of the largest number the radio's floats can hold
BOOST = 100.0  # times the honest model, with the sign turned: it owns a mean, and passes for a model
NOISE = 10.0  # standard deviation of false noise, in root-mean-square weights of the honest model


class Byzantine:
    """The UAVs of a scenario that send false models, and these models."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        others = scenario.members
        if scenario.federation.station is None:
            others = others[others != scenario.federation.leader]  # who averages has no need to lie
        count = min(len(others), round(scenario.federation.byzantine_fraction * len(scenario.members)))
        draw = generator(scenario.seed, "byzantine")
        self.uavs = np.sort(draw.choice(others, count, replace=False)) if count else others[:0]

    def distort(self, number: int, uavs: NDArray[np.integer], coded: Coded, codec: Codec) -> Coded:
        """The uploads of `uavs` (S,) in a round, those of false ones replaced."""
        false = contains(self.uavs, uavs)
        if not false.any():
            return coded
        honest = codec.decode(coded.of(false))
        match self._scenario.federation.byzantine_kind:
            case "huge":
                largest = min(HUGE, codec.largest / 2)
                lies = np.where(honest < 0, -largest, largest)
            case "sign-flip":
                lies = -honest
            case "boost":
                limit = codec.largest / 2
                lies = np.clip(-BOOST * honest, -limit, limit)
            case "noise":
                drawn = zip(uavs[false].tolist(), honest, strict=True)
                lies = np.stack([self._noisy(number, uav, model, codec.largest / 2) for uav, model in drawn])
        falsified = Coded(coded.numbers.copy(), coded.scales.copy())
        falsified.numbers[false], falsified.scales[false] = codec.encode(lies, uavs[false], number)
        return falsified

    def _noisy(self, number: int, uav: int, honest: NDArray[np.float64], limit: float) -> NDArray[np.float64]:
        draw = generator(self._scenario.seed, "byzantine", 1 + number * self._scenario.uavs + uav)
        noise = NOISE * np.sqrt((honest * honest).mean()) * draw.standard_normal(len(honest))
        return np.clip(honest + noise, -limit, limit)
