"""The ClientApp of examples/flower_app in Flower's classic API: a NumPyClient."""

from flower_digits import task
from flwr.app import Context
from flwr.client import NumPyClient
from flwr.clientapp import ClientApp

NAMES = tuple(task.new_model())


class DigitsClient(NumPyClient):
    """Trains and tests on the digits of its node."""

    def __init__(self, partition, data, epochs, rate):
        self.partition, self.data, self.epochs, self.rate = partition, data, epochs, rate

    def get_parameters(self, config):
        return list(task.new_model().values())

    def fit(self, parameters, config):
        model = {name: array.copy() for name, array in zip(NAMES, parameters, strict=True)}
        seed = 1000 * config["server-round"] + self.partition
        loss = task.train(model, self.data, self.epochs, self.rate, seed, config.get("proximal_mu", 0.0))
        return list(model.values()), len(self.data[1]), {"train_loss": loss}

    def evaluate(self, parameters, config):
        loss, accuracy = task.test(dict(zip(NAMES, parameters, strict=True)), self.data)
        return loss, len(self.data[1]), {"eval_accuracy": accuracy}


def client_fn(context: Context):
    partition, partitions = context.node_config["partition-id"], context.node_config["num-partitions"]
    config = context.run_config
    data = task.train_data(partition, partitions)
    return DigitsClient(partition, data, config["local-epochs"], config["learning-rate"]).to_client()


app = ClientApp(client_fn)
