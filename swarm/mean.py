"""The mean of models, Eq. FL_AVG: of uploads, and of the means that heads of clusters hand on.

Models are by UAV; sums have the order of the UAVs, so that the order of arrival leaves no trace.
"""

import numpy as np

from meanflock.swarm.state import Floats

ABSURD = 1e9  # no weight of a learner that still learns: features are of order one, and so are the costs


def refuse(models: dict[int, Floats]) -> tuple[dict[int, Floats], list[int]]:
    """The models that can be averaged at all, and the UAVs, ascending, whose are not finite or absurdly large."""
    if not models:
        return models, []
    with np.errstate(invalid="ignore"):
        if (np.abs(np.concatenate(list(models.values()))) < ABSURD).all():  # as a rule; NaN is below nothing
            return models, []
        bad = sorted(uav for uav, vector in models.items() if not (np.abs(vector) < ABSURD).all())
    return {uav: vector for uav, vector in models.items() if uav not in bad}, bad


def fedavg(models: Floats) -> Floats:
    """Mean of the models `(S, L)`, at least one, added up in their order, `(L,)`."""
    total = np.zeros(models.shape[1])
    for model in models:
        total += model
    return total / len(models)


def stacked(models: dict[int, Floats]) -> Floats:
    """The models as rows in the order of the UAVs, `(S, L)`, at least one."""
    return np.stack([models[uav] for uav in sorted(models)]).astype(np.float64)


def relayed(models: dict[int, Floats]) -> Floats:
    """What a head hands on: `fedavg`, and the number of models behind it, `(L + 1,)`."""
    return np.append(fedavg(stacked(models)), float(len(models)))


def pooled(relays: dict[int, Floats]) -> Floats:
    """Mean of all models behind the relays, `(L + 1,)` each: Σ n_c w_c / Σ n_c."""
    rows = stacked(relays)
    total = np.zeros(rows.shape[1])
    for relay in rows:
        total[:-1] += relay[-1] * relay[:-1]
        total[-1] += relay[-1]
    return total[:-1] / total[-1]
