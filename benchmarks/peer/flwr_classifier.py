"""flwr: rounds of FedAvg of its simulation engine (ray) that train the classifier. `flwr_classifier.py N FOLDER`.

The folder has the task as arrays; the global model after the last round is written there as `global.npy`.
"""

import sys
from pathlib import Path

import numpy as np
from flwr.app import ArrayRecord, Context, Message, MetricRecord, RecordDict
from flwr.clientapp import ClientApp
from flwr.serverapp import Grid, ServerApp
from flwr.serverapp.strategy import FedAvg
from flwr.simulation import run_simulation
from serve import serve

CLIENTS, FOLDER = int(sys.argv[1]), Path(sys.argv[2])
KEYS = ("first", "first_offset", "second", "second_offset")
server, client = ServerApp(), ClientApp()


def array(name: str) -> np.ndarray:
    """An array of the task, of which only what is used is read."""
    return np.load(FOLDER / f"{name}.npy", mmap_mode="r")


def sgd(model: list[np.ndarray], inputs: np.ndarray, labels: np.ndarray, rate: float) -> list[np.ndarray]:
    """A step on a batch (B, 64), labels (B,): cross-entropy behind a layer of tanh units."""
    first, first_offset, second, second_offset = model
    hidden = np.tanh(inputs @ first + first_offset)
    outputs = hidden @ second + second_offset
    chances = np.exp(outputs - outputs.max(axis=1, keepdims=True))
    chances /= chances.sum(axis=1, keepdims=True)
    chances[np.arange(len(labels)), labels] -= 1.0
    error = chances / len(labels)
    back = (error @ second.T) * (1.0 - hidden**2)
    slopes = (inputs.T @ back, back.sum(axis=0), hidden.T @ error, error.sum(axis=0))
    return [weights - rate * slope for weights, slope in zip(model, slopes, strict=True)]


@client.train()
def train(message: Message, context: Context) -> Message:
    """The steps of this client in this round, in float64; sends floats of the task's width."""
    me, number = context.node_config["partition-id"], message.content["config"]["server-round"]
    model = [weights.astype(np.float64) for weights in message.content["arrays"].to_numpy_ndarrays()]
    inputs, labels = array("inputs"), array("labels")
    for batch in array("batches")[number - 1, :, me]:
        model = sgd(model, inputs[batch], labels[batch], float(array("rate")))
    sent = ArrayRecord([weights.astype(array("first").dtype) for weights in model])
    metrics = MetricRecord({"num-examples": int(array("samples")[me])})
    return Message(RecordDict({"arrays": sent, "metrics": metrics}), reply_to=message)


@server.main()
def rounds(grid: Grid, _context: Context) -> None:
    """All clients take part in each round, and none evaluates."""
    strategy = FedAvg(fraction_evaluate=0.0, min_train_nodes=CLIENTS, min_available_nodes=CLIENTS)
    first = ArrayRecord([np.array(array(key), dtype=np.float64) for key in KEYS])

    def all_rounds() -> None:
        trained = strategy.start(grid, first, num_rounds=len(array("batches"))).arrays.to_numpy_ndarrays()
        np.save(FOLDER / "global.npy", np.concatenate([weights.ravel() for weights in trained]))

    serve(all_rounds)


settings = {
    "init_args": {"log_to_driver": False, "object_store_memory": 100_000_000},
    "client_resources": {"num_cpus": 1, "num_gpus": 0.0},  # a worker for each core
}
run_simulation(server, client, CLIENTS, backend_config=settings)
