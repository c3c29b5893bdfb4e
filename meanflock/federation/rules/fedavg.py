"""FedAvg, Eq. FL_AVG: the mean of the models."""

from meanflock.federation.rules.base import Aggregator, Floats, Uploads


class FedAvg(Aggregator):
    """The mean of the models, weighted by the samples that their controllers declare.

    Added up in the order of the UAVs. Each number is the mean over the models in which it arrived.
    """

    name = "fedavg"
    bears_means = True

    def weights(self, uploads: Uploads) -> Floats:
        return uploads.samples
