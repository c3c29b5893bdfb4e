"""Marks of the significantly best row of a column: paired by seed, corrected for the number of comparisons.

The best row of a column is compared with every other one, seed by seed: by Student's paired t test, by McNemar's exact
test if a flight is a yes or a no. All comparisons of a table are one family: by Holm's method the chance that any of
its marks is wrong is at most 5 %. A row is marked if it differs significantly from every other row.
"""

import math
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from meanflock.results import statistics
from meanflock.studies.leaderboard.measures import Measure

ALPHA = 0.05
COMPETES = (
    0.99  # share of arrived UAVs; rows with less compete in no other column, because UAVs that stay behind save energy
)

SAFE = 0.9  # share of free flights that a safe row exceeds with a confidence of 1 − ALPHA

Floats = NDArray[np.float64]
Contest: TypeAlias = tuple[Measure, Mapping[str, Floats]]  # a measure, and the values (K,) of the rows, a seed each


def is_safe(free: ArrayLike) -> bool:
    """Returns whether the one-sided 95 % Clopper–Pearson bound of the share of free flights (K,) is at least 90 %.

    All of 29 or 30 flights must be free; fewer flights are never enough.
    """
    flights = np.asarray(free, dtype=np.float64)
    return statistics.share_at_least(int((flights > 0.5).sum()), len(flights)) >= SAFE


def holm(p_values: Sequence[float]) -> list[bool]:
    """Hypotheses that Holm's step-down method rejects, with a family-wise error rate of ALPHA."""
    order = np.argsort(p_values, kind="stable")
    rejected = [False] * len(order)
    for left, number in enumerate(order):
        if not p_values[number] <= ALPHA / (len(order) - left):
            break
        rejected[number] = True
    return rejected


def paired(first: ArrayLike, second: ArrayLike) -> float:
    """Two-sided p value that two columns (K,) of the same seeds have the same mean: Student's paired t test. If all
    differences are equal, so that their spread cannot be estimated, the sign test.
    """
    difference = np.asarray(first, dtype=np.float64) - np.asarray(second, dtype=np.float64)
    if len(difference) < 2 or not np.isfinite(difference).all() or not difference.any():
        return 1.0
    if np.ptp(difference) == 0.0:
        return float(2.0 * 0.5 ** len(difference))
    error = float(difference.std(ddof=1)) / math.sqrt(len(difference))
    return float(2.0 * special.stdtr(len(difference) - 1, -abs(float(difference.mean())) / error))


def mcnemar(first: ArrayLike, second: ArrayLike) -> float:
    """Two-sided exact p value that two columns (K,) of yes and no, of the same seeds, have the same share."""
    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    only_a, only_b = int((a & ~b).sum()), int((b & ~a).sum())
    return min(1.0, 2.0 * float(special.bdtr(min(only_a, only_b), only_a + only_b, 0.5)))


def best(contests: Sequence[Contest]) -> set[tuple[str, str]]:
    """The marks, as key of the measure and row.

    Args:
        contests: for each measure the rows that compete; all columns are of the same seeds. A measure may occur more
            than once, with other rows.
    """
    tests: list[tuple[int, float]] = []  # number of the contest, p value of its best row against another
    leaders: dict[int, tuple[str, str]] = {}
    for number, (measure, rows) in enumerate(contests):
        known = {name: values for name, values in rows.items() if np.isfinite(values).all()}
        if len(known) < 2:
            continue
        sign = 1.0 if measure.better == "less" else -1.0
        first = min(known, key=lambda name: sign * float(known[name].mean()))
        leaders[number] = measure.key, first
        test = mcnemar if measure.share else paired
        tests += [(number, test(known[first], values)) for name, values in known.items() if name != first]
    for (number, _), rejected in zip(tests, holm([p for _, p in tests]), strict=True):
        if not rejected:
            leaders.pop(number, None)
    return set(leaders.values())
