"""The mean weighted by precision: who has measured a quantity counts for it, who has not does not."""

from typing import Annotated

import numpy as np
from msgspec import Meta

from meanflock.federation.rules import base
from meanflock.federation.rules.base import Aggregator, Floats, State, Uploads


class Precision(Aggregator):
    """The mean weighted by precision, of models that carry their precisions.

    A model is [means …, precisions]: some vectors of means, and one of the precisions, 1/variance, that they share.

    Of each quantity the global mean is Σ λ m / Σ λ, as that of the product of Gaussians, and the global precision the
    mean of λ: what everybody has from the last round counts once, not once for each. A precision below 0 counts as 0;
    of what nobody knows the mean is the plain one. `means` is how many vectors of means there are.
    """

    name = "precision"

    class Options(base.Options, frozen=True):
        """The options of `precision`."""

        means: Annotated[int, Meta(ge=1, le=1000, description="vectors of means that share one of precisions")] = 2

    def init(self, parameters: int) -> State:
        parts = self.options.means + 1
        if parameters % parts:
            raise ValueError(
                f"a model of {parameters} numbers is no {parts} vectors of equal length; set `federation.options.means`"
            )
        return {}

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        parts = uploads.models.reshape(len(uploads.models), self.options.means + 1, -1)
        arrived = uploads.arrived.reshape(parts.shape)
        complete = arrived.all(axis=1)  # a mean without its precision counts as unknown, and so does the reverse
        weights = np.where(complete, np.maximum(parts[:, -1], 0.0), 0.0)
        weight_sum = np.zeros_like(weights[0])
        weighted_sum = np.zeros_like(parts[0, :-1])
        plain_sum = np.zeros_like(parts[0, :-1])
        for means, weight in zip(parts[:, :-1], weights, strict=True):
            weight_sum = weight_sum + weight
            weighted_sum = weighted_sum + weight * means
            plain_sum = plain_sum + means
        is_weighted = weight_sum > 0.0
        mean = np.where(is_weighted, weighted_sum / np.where(is_weighted, weight_sum, 1.0), plain_sum / len(parts))
        return state, np.concatenate([mean, (weight_sum / np.maximum(complete.sum(axis=0), 1))[None]]).reshape(-1)
