"""flwr: the average of N models of 246 floats, as its server's FedAvg takes it. `flwr_average.py N`."""

import sys

import numpy as np
from flwr.server.strategy.aggregate import aggregate
from serve import serve

models = [([model], 1) for model in np.random.default_rng(1).random((int(sys.argv[1]), 246))]
serve(lambda: aggregate(models))
