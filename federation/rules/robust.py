"""Robust rules: aggregation that withstands false uploads."""

import math

import numpy as np

from meanflock.federation.rules.base import Aggregator, Floats, State, Uploads


class Median(Aggregator):
    """The median of every coordinate.

    Of an even number of models, the mean of the middle two. It withstands false uploads from fewer than half of the
    UAVs (Yin et al. 2018).
    """

    name = "median"

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        ordered = np.sort(uploads.models + 0.0, axis=0)  # adding zero makes −0 and 0 the same number
        middle, odd = divmod(len(ordered), 2)
        return state, ordered[middle].copy() if odd else (ordered[middle - 1] + ordered[middle]) / 2.0


class TrimmedMean(Aggregator):
    """The mean without the ⌈tolerance·n⌉ smallest and largest values of every coordinate; at least one is left.

    `federation.tolerance` is the share of uploads that are taken to be false (Yin et al. 2018).
    """

    name = "trimmed-mean"

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        ordered = np.sort(uploads.models + 0.0, axis=0)  # adding zero makes −0 and 0 the same number
        cut = suspects(len(ordered), self.scenario.federation.tolerance)
        total = np.zeros(ordered.shape[1])
        for row in ordered[cut : len(ordered) - cut]:
            total += row
        return state, total / (len(ordered) - 2 * cut)


class Krum(Aggregator):
    """The model that is nearest to most others.

    The one whose n − f − 2 nearest others are nearest, f = ⌈tolerance·n⌉ (Blanchard et al. 2017).

    Of equally good ones, the first in lexicographic order of the weights. `federation.tolerance` is the share of
    uploads that are taken to be false.
    """

    name = "krum"

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        rows = uploads.models + 0.0
        nearest = max(1, len(rows) - suspects(len(rows), self.scenario.federation.tolerance) - 2)
        scores = []
        for row in rows:
            difference = rows - row
            others = np.sort((difference * difference).sum(axis=-1))[1 : 1 + nearest]  # the first is the model itself
            scores.append(float(others.sum()))
        best = min(scores)
        return state, np.array(min(tuple(row) for row, score in zip(rows, scores, strict=True) if score == best))


def suspects(count: int, tolerance: float) -> int:
    """Number of uploads out of `count` that are taken to be false, ⌈tolerance·count⌉; at most ⌊(count − 1)/2⌋."""
    return min(math.ceil(tolerance * count - 1e-9), (count - 1) // 2)
