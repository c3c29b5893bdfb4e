"""FedAvg, Eq. FL_AVG: the mean of the models."""

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.rules.base import Aggregator, Floats, State, Uploads


class FedAvg(Aggregator):
    """The mean of the models, weighted by the samples that their controllers declare.

    Added up in the order of the UAVs. Each weight is the mean over the models in which it arrived.
    """

    name = "fedavg"

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        return state, mean(uploads.models, uploads.samples, uploads.arrived)

    def weights(self, uploads: Uploads) -> Floats:
        return uploads.samples


def mean(models: Floats, weights: Floats | None = None, arrived: NDArray[np.bool_] | None = None) -> Floats:
    """Mean of models `(S, L)`, at least one, added up in their order, `(L,)`, Eq. FL_AVG.

    Args:
        models: the models.
        weights: (S,) or (S, L), what each counts; None: all the same.
        arrived: (S, L), weights of the models that count; None: all. The mean of none of them is 0.
    """
    weights = np.ones(len(models)) if weights is None else weights
    total = np.zeros(models.shape[1])
    if arrived is None or arrived.all():
        for model, weight in zip(models, weights, strict=True):
            total += weight * model
        count = np.add.accumulate(weights, axis=0)[-1]
        return total / np.where(count > 0.0, count, 1.0)
    count = np.zeros(models.shape[1])
    for model, weight, here in zip(models, weights, arrived, strict=True):
        share = np.where(here, weight, 0.0)
        total += share * model
        count += share
    return total / np.where(count > 0.0, count, 1.0)
