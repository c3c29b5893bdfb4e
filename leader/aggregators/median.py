"""The coordinate-wise median: withstands anything from fewer than half of the UAVs (Yin et al. 2018)."""

import numpy as np
from numpy.typing import NDArray

from meanflock.leader.aggregators.base import Aggregator, Floats, State


class Median(Aggregator):
    """The median of every coordinate.

    Of an even number of models, the mean of the middle two.
    """

    name = "median"

    def step(self, state: State, models: Floats, uavs: NDArray[np.intp], round_: int) -> tuple[State, Floats]:
        ordered = np.sort(models + 0.0, axis=0)  # adding zero makes −0 and 0 the same number
        middle, odd = divmod(len(ordered), 2)
        return state, ordered[middle].copy() if odd else (ordered[middle - 1] + ordered[middle]) / 2.0
