"""A mod for Flower that replays the radio of a flight: uploads that the radio lost fail, and late ones wait.

    meanflock export RUN --radio radio.json     # --plugin RUN/plugins/NAME.py if it flew a plug-in of a file
    app = ClientApp(mods=[radio_mod("radio.json")])

For models that are too large to fly here: they train in your engine, and the radio is that of a flight.
"""

import json
import time
from pathlib import Path


def radio_mod(path, least=1.0, seconds=0.0):
    """Make a mod: uploads of which less than the share `least` arrived fail; others wait `seconds` per s of delay."""
    uploads = {(one["round"], one["uav"]): one for one in json.loads(Path(path).read_text())["uploads"]}

    def mod(message, context, call_next):
        reply = call_next(message, context)
        if message.metadata.message_type.partition(".")[0] != "train":
            return reply
        number = next(record["server-round"] for record in message.content.config_records.values())
        upload = uploads.get((number, context.node_config["partition-id"]))
        if upload is None or upload["arrived"] < least:
            raise ConnectionError(f"the radio lost the upload of round {number}")
        time.sleep(seconds * upload["delay_s"])
        return reply

    return mod
