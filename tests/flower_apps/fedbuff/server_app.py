"""A ServerApp with a loop of its own, FedBuff: it pushes messages and pulls replies, however late they are."""

import json
import time

import numpy as np
from flower_digits import task
from flwr.app import Array, ArrayRecord, ConfigRecord, Context, Message, MessageType, RecordDict
from flwr.serverapp import Grid, ServerApp

app = ServerApp()


@app.main()
def main(grid: Grid, context: Context) -> None:
    config = context.run_config
    size = json.loads(config["strategy-options"]).get("size", 10)
    model, version, waiting, accuracy = task.new_model(), 1, set(), []
    errors = 0

    def ask(nodes):
        arrays = ArrayRecord({name: Array(array) for name, array in model.items()})
        content = RecordDict({"arrays": arrays, "config": ConfigRecord({"server-round": version})})
        messages = [Message(content, dst_node_id=node, message_type=MessageType.TRAIN) for node in nodes]
        waiting.update(grid.push_messages(messages))

    ask(sorted(grid.get_node_ids()))
    while version <= config["num-server-rounds"]:
        weight, total, count = 0.0, dict.fromkeys(model, 0.0), 0
        while count < size:
            free = []
            for reply in sorted(grid.pull_messages(waiting), key=lambda reply: reply.metadata.src_node_id):
                waiting.discard(reply.metadata.reply_to_message_id)
                free.append(reply.metadata.src_node_id)
                if reply.has_error():
                    errors += 1
                    continue
                share = reply.content["metrics"]["num-examples"]
                trained = reply.content["arrays"]
                total = {name: total[name] + share * trained[name].numpy() for name in model}
                weight, count = weight + share, count + 1
            if count < size:
                ask(free)
            time.sleep(0.01)
        model = {name: (array / weight).astype(np.float32) for name, array in total.items()}
        version += 1
        accuracy.append(task.test(model, task.test_data())[1])
        ask(free)
    if config["save-to"]:
        np.savez(config["save-to"], *model.values(), accuracy=accuracy, errors=errors)
