"""rclpy, the client library of ROS 2, reads a bag that meanflock wrote."""

import json
from pathlib import Path

import numpy as np

import meanflock as mf
from meanflock.cli.command import main
from tests.commands import printed

SCRIPT = Path(__file__).with_name("rclpy_reads.py")
JUDGE = "rclpy"


def test_rclpy_reads_the_states_that_were_flown_as_messages_of_its_own_types(python: Path, tmp_path: Path) -> None:
    kill = {"kind": "kill", "time_s": 3.0, "uavs": [2]}
    run = mf.fly("paper", uavs=5, duration=20, seed=7, faults=[kill], out=tmp_path / "runs")
    assert main(["export", str(run.folder), "--rosbag", str(tmp_path / "bag"), "--quiet"]) == 0
    np.save(tmp_path / "states.npy", run.states)
    said = json.loads(printed(python, SCRIPT, tmp_path / "bag", tmp_path / "states.npy"))
    assert all(written == of_rclpy for written, of_rclpy in said["hashes"])
    assert said["unknown"] == ["tf2_msgs/msg/TFMessage"]  # there is no wheel of its package
    counts, ticks = said["counts"], len(run.states)
    assert len(counts) == len(said["hashes"])
    assert counts["/rosout"] == len(run.events)
    for topic in ("/diagnostics", "/uavs", "/mission"):
        assert counts.pop(topic) == 21  # one a second
    assert {count for topic, count in counts.items() if topic != "/rosout"} == {ticks}
    assert (said["equal"], said["lost"]) == (3 * ticks, ["uav_2"])
    assert said["labels"] == [["0", "1", "2", "3", "4"], ["0", "1", "2 lost", "3", "4"]]
