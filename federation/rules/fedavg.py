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
    counts_alike = weights is None or bool((weights == 1.0).all())
    weights = np.ones(len(models)) if weights is None else weights
    is_whole = arrived is None or bool(arrived.all())
    total = np.zeros(models.shape[1])
    product = np.empty_like(total)  # of a model; 0 elsewhere
    for place, model in enumerate(models):
        share = model if counts_alike else weights[place] * model
        if arrived is not None and not is_whole:
            share = np.multiply(share, arrived[place], out=product)
        total += share
    count: Floats | NDArray[np.int32]
    if arrived is None or is_whole:
        count = np.add.accumulate(weights, axis=0)[-1]
    elif counts_alike:
        count = np.add.reduce(arrived.view(np.uint8), axis=0, dtype=np.int32)
    else:
        count = np.zeros(models.shape[1])
        for weight, here in zip(weights, arrived, strict=True):
            count += np.where(here, weight, 0.0)
    return total / np.where(count > 0, count, 1)
