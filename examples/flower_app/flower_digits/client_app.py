"""ClientApp: trains on the digits of its node."""

from flwr.app import Array, ArrayRecord, Context, Message, MetricRecord, RecordDict
from flwr.clientapp import ClientApp

from flower_digits import task

app = ClientApp()


def model_in(message):
    """Returns copies of the arrays of a message."""
    return {name: array.numpy().copy() for name, array in message.content["arrays"].items()}


@app.train()
def train(message: Message, context: Context) -> Message:
    """Train the global model for some epochs."""
    partition, partitions = context.node_config["partition-id"], context.node_config["num-partitions"]
    model, config, data = model_in(message), message.content["config"], task.train_data(partition, partitions)
    seed = 1000 * config["server-round"] + partition
    rate, epochs = context.run_config["learning-rate"], context.run_config["local-epochs"]
    loss = task.train(model, data, epochs, rate, seed, config.get("proximal-mu", 0.0))
    metrics = MetricRecord({"train_loss": loss, "num-examples": len(data[1])})
    arrays = ArrayRecord({name: Array(array) for name, array in model.items()})
    return Message(RecordDict({"arrays": arrays, "metrics": metrics}), reply_to=message)


@app.evaluate()
def evaluate(message: Message, context: Context) -> Message:
    """Test the global model on the digits of this node."""
    data = task.train_data(context.node_config["partition-id"], context.node_config["num-partitions"])
    loss, accuracy = task.test(model_in(message), data)
    metrics = MetricRecord({"eval_loss": loss, "eval_accuracy": accuracy, "num-examples": len(data[1])})
    return Message(RecordDict({"metrics": metrics}), reply_to=message)
