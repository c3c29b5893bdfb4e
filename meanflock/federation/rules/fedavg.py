"""FedAvg, Eq. FL_AVG: the mean of the models."""

from meanflock.federation.rules.base import Aggregator, Floats, State, Uploads, mean


class FedAvg(Aggregator):
    """The mean of the models, weighted by the samples that their controllers declare.

    Added up in the order of the UAVs. Each weight is the mean over the models in which it arrived.
    """

    name = "fedavg"
    bears_means = True

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        if (uploads.samples == 1.0).all():
            return state, uploads.mean
        return state, mean(uploads.models, uploads.samples, uploads.arrived)

    def weights(self, uploads: Uploads) -> Floats:
        return uploads.samples
