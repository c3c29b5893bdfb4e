"""Krum (Blanchard et al. 2017): one of the models, and no mixture."""

import numpy as np
from numpy.typing import NDArray

from meanflock.leader.aggregators.base import Aggregator, Floats, State
from meanflock.leader.aggregators.suspects import suspects


class Krum(Aggregator):
    """The model that is nearest to most others.

    The one whose n − f − 2 nearest others are nearest, f = ⌈tolerance·n⌉.

    Of equally good ones, the first in lexicographic order of the weights. `federation.tolerance` is the share of
    uploads that are taken to be false.
    """

    name = "krum"

    def step(self, state: State, models: Floats, uavs: NDArray[np.intp], round_: int) -> tuple[State, Floats]:
        rows = models + 0.0
        nearest = max(1, len(rows) - suspects(len(rows), self.scenario.federation.tolerance) - 2)
        scores = []
        for row in rows:
            difference = rows - row
            others = np.sort((difference * difference).sum(axis=-1))[1 : 1 + nearest]  # the first is the model itself
            scores.append(float(others.sum()))
        best = min(scores)
        return state, np.array(min(tuple(row) for row, score in zip(rows, scores, strict=True) if score == best))
