"""flwr: a round of FedAvg with N clients of its simulation engine (ray), models of 246 floats. `flwr_round.py N`."""

import sys

import numpy as np
from flwr.app import ArrayRecord, Context, Message, MetricRecord, RecordDict
from flwr.clientapp import ClientApp
from flwr.serverapp import Grid, ServerApp
from flwr.serverapp.strategy import FedAvg
from flwr.simulation import run_simulation
from serve import serve

FLOATS = 246
server, client = ServerApp(), ClientApp()


@client.train()
def one_gradient_step(message: Message, context: Context) -> Message:
    """Without a framework, towards a target of this client's own."""
    (weights,) = message.content["arrays"].to_numpy_ndarrays()
    target = np.random.default_rng(context.node_config["partition-id"]).random(FLOATS, dtype=np.float32)
    weights = weights - np.float32(0.01) * (weights - target)
    content = {"arrays": ArrayRecord([weights]), "metrics": MetricRecord({"num-examples": 1})}
    return Message(RecordDict(content), reply_to=message)


@server.main()
def rounds(grid: Grid, _context: Context) -> None:
    """Everybody takes part in each, and nobody evaluates."""
    clients = int(sys.argv[1])
    strategy = FedAvg(fraction_evaluate=0.0, min_train_nodes=clients, min_available_nodes=clients)
    models = [ArrayRecord([np.zeros(FLOATS, dtype=np.float32)])]

    def one_round() -> None:
        models[0] = strategy.start(grid, models[0], num_rounds=1).arrays

    serve(one_round)
    assert models[0].to_numpy_ndarrays()[0].min() > 0.0


settings = {
    "init_args": {"log_to_driver": False, "object_store_memory": 100_000_000},
    "client_resources": {"num_cpus": 1, "num_gpus": 0.0},  # a worker for each core
}
run_simulation(server, client, int(sys.argv[1]), backend_config=settings)
