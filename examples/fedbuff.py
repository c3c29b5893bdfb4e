"""An aggregation rule in a file: buffered averaging of late uploads (FedBuff, Nguyen et al. 2022)."""

from typing import Annotated

import numpy as np
from msgspec import Meta

import meanflock as mf


class FedBuff(mf.Aggregator):
    """Waits for `size` uploads and averages them, an upload of an earlier round for less than a new one."""

    name = "fedbuff"

    class Options(mf.Options, frozen=True):
        size: Annotated[int, Meta(ge=1, description="uploads that make a global model")] = 30

    def init(self, parameters):
        return {"count": np.zeros(1), "weight": np.zeros(1), "total": np.zeros(parameters)}

    def step(self, state, uploads):
        weights = 1.0 / np.sqrt(1.0 + uploads.round - uploads.sent)
        count = state["count"] + len(weights)
        weight, total = state["weight"] + weights.sum(), state["total"] + weights @ uploads.models
        if count[0] < self.options.size:
            return {"count": count, "weight": weight, "total": total}, None
        return self.init(len(total)), total / weight
