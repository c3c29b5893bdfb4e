"""ServerApp: rounds of a strategy of Flower, and a test of the global model after each."""

import json

import numpy as np
from flwr.app import Array, ArrayRecord, Context, MetricRecord
from flwr.serverapp import Grid, ServerApp, strategy

from flower_digits import task

app = ServerApp()


def evaluate(server_round: int, arrays: ArrayRecord) -> MetricRecord:
    """Test the global model on all digits."""
    loss, accuracy = task.test({name: array.numpy() for name, array in arrays.items()}, task.test_data())
    return MetricRecord({"loss": loss, "accuracy": accuracy})


@app.main()
def main(grid: Grid, context: Context) -> None:
    """Train with the strategy of the configuration."""
    config = context.run_config
    chosen = getattr(strategy, config["strategy"])(
        fraction_train=config["fraction-train"],
        fraction_evaluate=config["fraction-evaluate"],
        **json.loads(config["strategy-options"]),
    )
    first = ArrayRecord({name: Array(array) for name, array in task.new_model().items()})
    result = chosen.start(grid, first, num_rounds=config["num-server-rounds"], evaluate_fn=evaluate)
    if config["save-to"]:
        accuracy = [record["accuracy"] for _, record in sorted(result.evaluate_metrics_serverapp.items())]
        np.savez(config["save-to"], *result.arrays.to_numpy_ndarrays(), accuracy=accuracy)
