"""The ServerApp of examples/flower_app in Flower's classic API: a Strategy."""

import json

import numpy as np
from flower_digits import task
from flwr.app import Context
from flwr.common import ndarrays_to_parameters
from flwr.server import ServerAppComponents, ServerConfig, strategy
from flwr.serverapp import ServerApp

NAMES = tuple(task.new_model())


def server_fn(context: Context):
    config = context.run_config
    accuracy = []

    def evaluate(server_round, arrays, _config):
        loss, share = task.test(dict(zip(NAMES, arrays, strict=True)), task.test_data())
        accuracy.append(share)
        if config["save-to"]:
            np.savez(config["save-to"], *arrays, accuracy=accuracy)
        return loss, {"accuracy": share}

    options = json.loads(config["strategy-options"])
    if not options.pop("ask-for-parameters", False):
        options["initial_parameters"] = ndarrays_to_parameters(list(task.new_model().values()))
    chosen = getattr(strategy, config["strategy"])(
        fraction_fit=config["fraction-train"],
        fraction_evaluate=config["fraction-evaluate"],
        evaluate_fn=evaluate,
        on_fit_config_fn=lambda server_round: {"server-round": server_round},
        **options,
    )
    return ServerAppComponents(strategy=chosen, config=ServerConfig(num_rounds=config["num-server-rounds"]))


app = ServerApp(server_fn=server_fn)
