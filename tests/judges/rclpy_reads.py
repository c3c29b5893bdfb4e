"""A script for an environment with rclpy: reads a bag and prints as JSON what the test compares.

Arguments: the folder of the bag, and a file with the states [x, y, vx, vy] of every tick and UAV, (T, N, 4).
"""

import json
import sys
from collections import Counter
from importlib import import_module
from pathlib import Path

import numpy as np
import rclpy
import yaml
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message

bag, states = Path(sys.argv[1]), np.load(sys.argv[2])
described = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
topics = [topic["topic_metadata"] for topic in described["topics_with_message_count"]]
rclpy.init()
node = rclpy.create_node("judge")
kinds, hashes, unknown = {}, [], []
for topic in topics:
    package, _, kind = topic["type"].split("/")
    try:
        kinds[topic["name"]] = getattr(import_module(f"{package}.msg"), kind)
    except ModuleNotFoundError:
        unknown.append(topic["type"])
        continue
    node.create_publisher(kinds[topic["name"]], f"/judge{topic['name']}", 1)
    (published,) = node.get_publishers_info_by_topic(f"/judge{topic['name']}")
    hashes.append([topic["type_description_hash"], str(published.topic_type_hash)])
rclpy.shutdown()

counts, equal, lost, labels = Counter(), 0, set(), []
with (bag / described["relative_file_paths"][0]).open("rb") as stream:
    for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
        if channel.topic not in kinds:
            continue
        read = deserialize_message(message.data, kinds[channel.topic])
        flown = states[min(counts[channel.topic], len(states) - 1)]
        if channel.topic == "/swarm/poses":
            places = [(pose.position.x, pose.position.y) for pose in read.poses]
            in_time = read.header.stamp.sec * 10**9 + read.header.stamp.nanosec == message.log_time
            equal += in_time and np.array(places).tobytes() == flown[:, :2].tobytes()
        elif channel.topic == "/swarm/states":
            equal += (
                np.array([(twist.linear.x, twist.linear.y) for twist in read.twist]).tobytes() == flown[:, 2:].tobytes()
            )
        elif channel.topic == "/series/x_m":
            equal += np.array(read.data).tobytes() == flown[:, 0].tobytes()
        elif channel.topic == "/uavs":
            labels.append([marker.text for marker in read.markers if marker.text])
        elif channel.topic == "/diagnostics":
            lost |= {status.hardware_id for status in read.status if status.level == b"\x02"}
        counts[channel.topic] += 1
said = {"hashes": hashes, "unknown": unknown, "counts": counts, "equal": int(equal), "lost": sorted(lost)}
print(json.dumps(said | {"labels": [labels[0], labels[-1]]}))
