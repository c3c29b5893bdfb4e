"""FedAvg, Eq. FL_AVG: the mean of the models."""

import numpy as np
from numpy.typing import NDArray

from meanflock.leader.aggregators.base import Aggregator, Floats, State
from meanflock.swarm.mean import fedavg


class FedAvg(Aggregator):
    """The mean of the models.

    Added up in the order of the UAVs.
    """

    name = "fedavg"

    def step(self, state: State, models: Floats, uavs: NDArray[np.intp], round_: int) -> tuple[State, Floats]:
        return state, fedavg(models)
