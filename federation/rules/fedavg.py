"""FedAvg, Eq. FL_AVG: the mean of the models."""

import numpy as np

from meanflock.federation.rules.base import Aggregator, Floats, State, Uploads


class FedAvg(Aggregator):
    """The mean of the models.

    Added up in the order of the UAVs.
    """

    name = "fedavg"

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        return state, mean(uploads.models)

    def weights(self, uploads: Uploads) -> Floats:
        return np.ones(len(uploads.models))


def mean(models: Floats, weights: Floats | None = None) -> Floats:
    """Mean of the models `(S, L)`, at least one, added up in their order, `(L,)`, Eq. FL_AVG; weights (S,)."""
    total, count = np.zeros(models.shape[1]), 0.0
    for model, weight in zip(models, np.ones(len(models)) if weights is None else weights, strict=True):
        total += weight * model
        count += weight
    return total / count
