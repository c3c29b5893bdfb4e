"""One model of many: FedAvg, Eq. FL_AVG, and rules that a few false uploads cannot move far.

Every rule takes the models by UAV, `(L,)` each, and leaves no trace of the order in which they arrived; all but
`fedavg`, whose sum has the order of the UAVs, do not depend on who sent which either.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from swarm.mean import fedavg

Floats = NDArray[np.float64]


def median(models: dict[int, Floats]) -> Floats:
    """Coordinate-wise median: withstands anything from fewer than half of the UAVs."""
    ordered = _sorted(models)
    middle, odd = divmod(len(ordered), 2)
    return ordered[middle].copy() if odd else (ordered[middle - 1] + ordered[middle]) / 2.0


def trimmed_mean(models: dict[int, Floats], tolerance: float) -> Floats:
    """Coordinate-wise mean without the ⌈tolerance·n⌉ smallest and largest values; at least one value is left."""
    ordered = _sorted(models)
    cut = suspects(len(ordered), tolerance)
    total = np.zeros(ordered.shape[1])
    for row in ordered[cut : len(ordered) - cut]:
        total += row
    return total / (len(ordered) - 2 * cut)


def krum(models: dict[int, Floats], tolerance: float) -> Floats:
    """The one model whose n − f − 2 nearest others are nearest, f = ⌈tolerance·n⌉ (Blanchard et al. 2017).

    Of equally good ones, the first in lexicographic order of the weights.
    """
    rows = _stack(models) + 0.0
    nearest = max(1, len(rows) - suspects(len(rows), tolerance) - 2)
    scores = []
    for row in rows:
        difference = rows - row
        others = np.sort((difference * difference).sum(axis=-1))[1 : 1 + nearest]  # the first is the model itself
        scores.append(float(others.sum()))
    best = min(scores)
    return np.array(min(tuple(row) for row, score in zip(rows, scores, strict=True) if score == best))


def suspects(count: int, tolerance: float) -> int:
    """f: how many of `count` uploads are taken to be false; never so many that none is left between them."""
    return min(math.ceil(tolerance * count - 1e-9), (count - 1) // 2)


def rule(name: str, tolerance: float) -> Callable[[dict[int, Floats]], Floats]:
    """The rule a scenario names."""
    rules: dict[str, Callable[[dict[int, Floats]], Floats]] = {
        "fedavg": fedavg,
        "median": median,
        "trimmed-mean": lambda models: trimmed_mean(models, tolerance),
        "krum": lambda models: krum(models, tolerance),
    }
    return rules[name]


def _stack(models: dict[int, Floats]) -> Floats:
    if not models:
        raise ValueError("nothing arrived to average")
    return np.stack([models[uav] for uav in sorted(models)]).astype(np.float64)


def _sorted(models: dict[int, Floats]) -> Floats:
    """Every coordinate's values, ascending, `(n, L)`. Adding zero makes −0 and 0 the same number."""
    return np.sort(_stack(models) + 0.0, axis=0)
