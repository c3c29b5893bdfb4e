"""pfl: a simulated round of N clients that each take one gradient step on 246 floats. `pfl_round.py N`."""

import sys
from itertools import cycle

import numpy as np
from pfl.aggregate.simulate import SimulatedBackend
from pfl.algorithm.base import NNAlgorithmParams
from pfl.algorithm.federated_averaging import FederatedAveraging
from pfl.data.dataset import Dataset
from pfl.data.federated_dataset import FederatedDataset
from pfl.hyperparam import NNTrainHyperParams
from pfl.metrics import Metrics
from pfl.model.base import StatefulModel
from pfl.stats import MappedVectorStatistics
from serve import serve

FLOATS = 246


class Vector(StatefulModel):
    """A model that is 246 floats."""

    def __init__(self) -> None:
        self.weights = np.zeros(FLOATS)

    def get_parameters(self, placeholders: object = None) -> MappedVectorStatistics:
        return MappedVectorStatistics({"weights": self.weights.copy()})

    def set_parameters(self, w: MappedVectorStatistics) -> None:
        self.weights = w["weights"].copy()

    def get_model_difference(self, other_parameters: MappedVectorStatistics, clone: bool = False) -> object:
        return MappedVectorStatistics({"weights": self.weights - other_parameters["weights"]})

    def apply_model_update(self, statistics: MappedVectorStatistics) -> tuple["Vector", Metrics]:
        self.weights = self.weights + statistics["weights"]
        return self, Metrics()

    def evaluate(self, *_arguments: object, **_more: object) -> Metrics:
        return Metrics()

    def save(self, dir_path: str) -> None:
        raise NotImplementedError

    def load(self, dir_path: str) -> None:
        raise NotImplementedError


class Averaging(FederatedAveraging):
    """FedAvg whose clients take one gradient step without a framework."""

    def train_one_user(
        self, initial_model_state: object, model: Vector, user_dataset: Dataset, central_context: object
    ):
        (target,) = user_dataset.raw_data
        model.weights = model.weights - 0.01 * (model.weights - target)
        return model.get_model_difference(initial_model_state), Metrics()


clients = int(sys.argv[1])
targets = np.random.default_rng(1).random((clients, FLOATS))
data = FederatedDataset(lambda user: Dataset([targets[user]], user_id=str(user)), cycle(range(clients)).__next__)
backend, model = SimulatedBackend(training_data=data, val_data=data), Vector()
settings = NNAlgorithmParams(
    central_num_iterations=1, evaluation_frequency=1, train_cohort_size=clients, val_cohort_size=0
)
train = NNTrainHyperParams(local_num_epochs=1, local_learning_rate=0.01, local_batch_size=None)


def one_round() -> None:
    Averaging().run(settings, backend, model, train, send_metrics_to_platform=False)


serve(one_round)
assert np.abs(model.weights).max() > 0.0
