"""The coordinate-wise trimmed mean (Yin et al. 2018)."""

import numpy as np
from numpy.typing import NDArray

from meanflock.leader.aggregators.base import Aggregator, Floats, State
from meanflock.leader.aggregators.suspects import suspects


class TrimmedMean(Aggregator):
    """The mean without the ⌈tolerance·n⌉ smallest and largest values of every coordinate; at least one is left.

    `federation.tolerance` is the share of uploads that are taken to be false.
    """

    name = "trimmed-mean"

    def step(self, state: State, models: Floats, uavs: NDArray[np.intp], round_: int) -> tuple[State, Floats]:
        ordered = np.sort(models + 0.0, axis=0)  # adding zero makes −0 and 0 the same number
        cut = suspects(len(ordered), self.scenario.federation.tolerance)
        total = np.zeros(ordered.shape[1])
        for row in ordered[cut : len(ordered) - cut]:
            total += row
        return state, total / (len(ordered) - 2 * cut)
