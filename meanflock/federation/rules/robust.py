"""Robust rules: aggregation that withstands false uploads."""

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.rules.base import Aggregator, Floats, State, Uploads


class Median(Aggregator):
    """The median of every coordinate.

    Of an even number of models, the mean of the middle two. It withstands false uploads from fewer than half of the
    UAVs (Yin et al. 2018).
    """

    name = "median"
    bears_silence = False

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        ordered, count = _ordered(uploads)
        low, high = (np.take_along_axis(ordered, middle[None], axis=0)[0] for middle in ((count - 1) // 2, count // 2))
        return state, np.where(uploads.arrived.any(axis=0), (low + high) / 2.0, 0.0)


class TrimmedMean(Aggregator):
    """The mean without the ⌈tolerance·n⌉ smallest and largest values of every coordinate; at least one is left.

    `federation.tolerance` is the share of uploads that are taken to be false (Yin et al. 2018).
    """

    name = "trimmed-mean"
    bears_silence = False

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        ordered, count = _ordered(uploads)
        cut = suspects(count, self.scenario.federation.tolerance)
        total = np.zeros(ordered.shape[1])
        for place, row in enumerate(ordered):
            total += np.where((place >= cut) & (place < count - cut), row, 0.0)
        return state, np.where(uploads.arrived.any(axis=0), total / (count - 2 * cut), 0.0)


class Krum(Aggregator):
    """The model that is nearest to most others.

    The one whose n − f − 2 nearest others are nearest, f = ⌈tolerance·n⌉ (Blanchard et al. 2017).

    Of equally good ones, the first in lexicographic order of the weights. `federation.tolerance` is the share of
    uploads that are taken to be false. Models of which a fragment was lost do not count; of fewer than three that are
    complete, among more, none is chosen.
    """

    name = "krum"
    bears_silence = False
    complete = 3

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats | None]:
        complete = np.logical_and.reduce(uploads.arrived, axis=1)
        if complete.sum() < min(self.complete, len(complete)):
            return state, None
        rows = uploads.models[complete] + 0.0
        nearest = max(1, len(rows) - int(suspects(len(rows), self.scenario.federation.tolerance)) - 2)
        scores = []
        for row in rows:
            difference = rows - row
            others = np.sort((difference * difference).sum(axis=-1))[1 : 1 + nearest]  # the first is the model itself
            scores.append(float(others.sum()))
        best = min(scores)
        return state, np.array(min(tuple(row) for row, score in zip(rows, scores, strict=True) if score == best))


def suspects(count: NDArray[np.intp] | int, tolerance: float) -> NDArray[np.intp]:
    """Number of uploads out of `count` that are taken to be false, ⌈tolerance·count⌉; at most ⌊(count − 1)/2⌋."""
    wanted = np.ceil(tolerance * np.asarray(count) - 1e-9).astype(np.intp)
    return np.minimum(wanted, (np.asarray(count) - 1) // 2)


def _ordered(uploads: Uploads) -> tuple[Floats, NDArray[np.intp]]:
    """The weights that arrived, ascending, before all others (S, L); and how many arrived (L,), at least 1."""
    found = np.where(uploads.arrived, uploads.models + 0.0, np.inf)  # adding zero makes −0 and 0 the same number
    return np.sort(found, axis=0), np.maximum(uploads.arrived.sum(axis=0), 1)
