"""What all UAVs have of something, tick by tick, as the few lines of a plot."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def span(values: NDArray[Any]) -> NDArray[np.float64]:
    """Mean, minimum and maximum over the UAVs: (T, N) to (T, 3)."""
    lines = np.empty((len(values), 3))
    values.mean(axis=1, dtype=np.float64, out=lines[:, 0])
    columns = np.ascontiguousarray(values.T)  # of two numbers the lesser, tick by tick: much faster than along them
    lines[:, 1], lines[:, 2] = columns.min(axis=0), columns.max(axis=0)
    return lines


def span_of(values: NDArray[Any], who: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The same over the UAVs `who` (T, N) alone; NaN in ticks in which there is none. A tick has the same bits in
    whatever batch it is."""
    if who.all():
        return span(values)
    lines, some = np.full((len(values), 3), np.nan), who.any(axis=1)
    values, who = values[some], who[some]
    mean = np.where(who, values, 0).sum(axis=1, dtype=np.float64) / np.count_nonzero(who, axis=1)
    low, high = np.where(who, values, np.inf).min(axis=1), np.where(who, values, -np.inf).max(axis=1)
    lines[some] = np.stack([mean, low, high], axis=-1)
    return lines


def log_sizes(values: NDArray[np.float32]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which ticks have a residual at all, (T,), and log10 of its largest and mean size there, (R, 2).

    A residual of exactly 0 is one nobody computed: before the first step, or of a lost UAV. It has no
    logarithm and counts for nothing.
    """
    size = np.abs(values.astype(np.float64))
    some = size > 0
    known: NDArray[np.bool_] = np.any(some, axis=1)
    if not known.all():
        size, some = size[known], some[known]
    mean = size.sum(axis=1) / np.count_nonzero(some, axis=1)
    largest = np.ascontiguousarray(size.T).max(axis=0)
    lines: NDArray[np.float64] = np.log10(np.stack([largest, mean], axis=-1))
    return known, lines
