"""`export`: the file that Foxglove and ROS 2 open, alone and as a bag, judged by readers of both."""

import errno
import json
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

import meanflock as mf
from meanflock.export import instants
from meanflock.export.bag import write_bag, write_mcap
from meanflock.results import flown as flown_flights
from meanflock.results.flown import FlightSoFar
from meanflock.results.stored_run import began
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, RunFailed
from meanflock.swarm.plugins import registry

STORE = get_typestore(Stores.ROS2_JAZZY)  # another distribution than that of the writer
KILL = {"kind": "kill", "time_s": 3.0, "uavs": [2]}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> mf.Run:
    """A flight in which UAV 2 is lost, with a folder."""
    out = tmp_path_factory.mktemp("flown")
    return mf.fly(
        "paper", uavs=5, duration=20, seed=7, faults=[KILL], obstacles=[{"centre": [9, 9], "radius": 2}], out=out
    )


def read(path: str) -> Iterator[tuple[str, int, Any]]:
    """Topic, time and content of each message of a file."""
    with Path(path).open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        for schema, channel, message in reader.iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            assert channel.metadata["topic_type_hash"] == STORE.hash_rihs01(schema.name)
            yield channel.topic, message.log_time, STORE.deserialize_cdr(message.data, schema.name)


def test_the_file_has_every_number_with_its_bits_and_every_event(run, flown) -> None:
    assert run("export", str(flown.folder), "--mcap", "out/r.mcap", "--quiet") == (EXIT_DONE, "out/r.mcap\n", "")
    topics: dict[str, list[Any]] = {}
    for topic, at_ns, message in read("out/r.mcap"):
        topics.setdefault(topic, []).append(message)
        if topic == "/tf":
            assert at_ns == round((len(topics["/tf"]) - 1) * flown.scenario.dt * 1e9)
    places = [
        [(one.transform.translation.x, one.transform.translation.y) for one in tf.transforms] for tf in topics["/tf"]
    ]
    assert np.array(places).tobytes() == flown.states[..., :2].tobytes()
    assert [one.child_frame_id for one in topics["/tf"][0].transforms] == [f"uav_{uav}" for uav in range(5)]
    rows = flown.frame().drop_columns(["leader_model"])
    for field in rows.schema:
        if pa.types.is_list(field.type):
            written = [message.data.tolist() for message in topics.pop(f"/series/{field.name}")]
        else:
            written = [message.data for message in topics.pop(f"/swarm/{field.name}")]
        expected = [np.nan if value is None else value for value in rows[field.name].to_pylist()]
        np.testing.assert_array_equal(written, expected, field.name, strict=True)
    lost = [status.count(2) for status in rows["status"].to_pylist()]
    assert [message.data for message in topics["/swarm/lost"]] == lost
    np.testing.assert_allclose(
        [message.data for message in topics["/swarm/energy_mean_J"]], np.mean(rows["energy_J"].to_pylist(), axis=1)
    )
    labels = [[marker.text for marker in scene.markers if marker.text] for scene in topics["/uavs"]]
    assert [texts for texts, _ in groupby(labels)] == [["0", "1", "2", "3", "4"], ["0", "1", "2 lost", "3", "4"]]
    assert {marker.header.frame_id for marker in topics["/uavs"][0].markers} == {f"uav_{uav}" for uav in range(5)}
    assert [event.name for event in topics["/rosout"]] == [f"meanflock.{event['kind']}" for event in flown.events]
    shapes = [[(marker.ns, marker.text, marker.scale.x) for marker in scene.markers] for scene in topics["/mission"]]
    radius = flown.scenario.destination.radius
    assert [shape for shape, _ in groupby(shapes)] == [
        [("goals", "", 2 * radius), ("obstacles", "", 4.0), ("labels", "goal", 0.0)]
    ]
    assert len(topics["/mission"]) == len(topics["/uavs"]) == len(topics["/diagnostics"]) == 21  # one a second
    with Path("out/r.mcap").open("rb") as file:
        assert [file.name for file in make_reader(file).iter_attachments()] == ["scenario.toml", "summary.json"]


def test_a_file_of_many_uavs_has_frames_of_some_and_series_of_all(run, flown, monkeypatch) -> None:
    monkeypatch.setattr(instants, "MOST_UAVS", 3)
    code, _, told = run("export", str(flown.folder), "--mcap", "some.mcap", "--quiet")
    assert code == EXIT_DONE
    assert "5 UAVs: frames, markers and diagnostics are those of 3, evenly chosen; /series/ has all" in told
    last = {topic: message for topic, _, message in read("some.mcap")}
    assert last["/swarm/states"].joint_names == ["uav_0", "uav_2", "uav_4"]
    assert [one.child_frame_id for one in last["/tf"].transforms] == ["uav_0", "uav_2", "uav_4"]
    assert [marker.text for marker in last["/uavs"].markers if marker.text] == ["0", "2 lost", "4"]
    assert [one.hardware_id for one in last["/diagnostics"].status] == ["swarm", "uav_0", "uav_2", "uav_4"]
    assert last["/swarm/lost"].data == 1
    assert len(last["/series/x_m"].data) == 5


def test_a_bag_has_every_state_with_its_bits(run, flown) -> None:
    assert run("export", str(flown.folder), "--rosbag", "bag", "--mcap", "r.mcap", "--quiet")[0] == EXIT_DONE
    counts, places, speeds = Counter(), [], []
    with Reader("bag") as reader:
        for connection, _, content in reader.messages():
            assert connection.digest == STORE.hash_rihs01(connection.msgtype)
            message = STORE.deserialize_cdr(content, connection.msgtype)
            counts[connection.topic] += 1
            if connection.topic == "/swarm/poses":
                places.append([(pose.position.x, pose.position.y) for pose in message.poses])
            elif connection.topic == "/swarm/states":
                speeds.append([(twist.linear.x, twist.linear.y) for twist in message.twist])
        assert {connection.topic: connection.msgcount for connection in reader.connections} == counts
        assert reader.message_count == counts.total()
    assert np.concatenate([places, speeds], axis=-1).tobytes() == flown.states.tobytes()
    assert counts["/rosout"] == len(flown.events)
    assert sorted(file.name for file in Path("bag").iterdir()) == ["bag.mcap", "metadata.yaml"]
    assert Path("bag/bag.mcap").read_bytes() == Path("r.mcap").read_bytes()


def test_a_flight_in_space_is_written_with_its_heights(run, tmp_path: Path) -> None:
    keys = {"space.dimensions": 3, "start.layers": 2, "wind.mean": (1.0, -1.0, 0.5), "method": "cruise"}
    solids = [
        {"centre": [80.0, 60.0], "radius": 3.0},
        {"centre": (9, 9), "radius": 2, "height": 30},
        {"centre": (9, 0, 50), "radius": 3},
    ]
    keys |= {"obstacles": solids, "stations": [{"place": (10.0, 20.0, 25.0)}]}
    flown = mf.fly("paper", uavs=5, duration=3, out=tmp_path, **keys)
    assert run("export", str(flown.folder), "--mcap", "space.mcap", "--quiet")[0] == EXIT_DONE
    places, speeds, heights, frames, middles = [], [], [], [], []
    for topic, _, message in read("space.mcap"):
        if topic == "/swarm/poses":
            places.append([(pose.position.x, pose.position.y, pose.position.z) for pose in message.poses])
        elif topic == "/swarm/states":
            speeds.append([(twist.linear.x, twist.linear.y, twist.linear.z) for twist in message.twist])
        elif topic == "/series/z_m":
            heights.append(message.data)
        elif topic == "/tf":
            frames.append([one.transform.translation.z for one in message.transforms])
        elif topic == "/mission":
            middles = [(one.ns, one.type, one.pose.position.z, one.scale.z) for one in message.markers]
    assert np.concatenate([places, speeds], axis=-1).tobytes() == flown.states.tobytes()
    assert np.array(heights).tobytes() == flown.states[..., 2].tobytes()
    assert np.array(frames).tobytes() == flown.states[..., 2].tobytes()
    top = float(flown.states[0, :, 2].max()) + 4.0
    cylinder, sphere, text = 3, 2, 9
    assert middles == [
        ("goals", cylinder, 40.0, 0.1),
        ("obstacles", cylinder, pytest.approx(top / 2), pytest.approx(top)),
        ("obstacles", cylinder, 15.0, 30.0),
        ("obstacles", sphere, 50.0, 6.0),
        ("stations", cylinder, 12.5, 25.0),
        ("labels", text, 42.0, 3.0),
    ]


def test_the_orientation_is_the_attitude_of_a_vehicle_that_shows_one(run, tmp_path: Path) -> None:
    keys = {"space.dimensions": 3, "method": "cruise", "vehicle.model": "quadrotor"}
    flown = mf.fly("paper", uavs=5, duration=3, out=tmp_path, **keys)
    assert run("export", str(flown.folder), "--mcap", "turned.mcap", "--quiet")[0] == EXIT_DONE
    poses = [message.poses for topic, _, message in read("turned.mcap") if topic == "/swarm/poses"]
    turns = [[[getattr(pose.orientation, axis) for axis in "xyzw"] for pose in each] for each in poses]
    x, y, z, w = np.moveaxis(np.array(turns), -1, 0)
    roll, pitch, yaw = (np.array(flown.frame()[name].to_pylist()) for name in ("roll_rad", "pitch_rad", "yaw_rad"))
    np.testing.assert_allclose(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), roll, atol=1e-12)
    np.testing.assert_allclose(np.arcsin(2 * (w * y - z * x)), pitch, atol=1e-12)
    np.testing.assert_allclose(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)), yaw, atol=1e-12)
    assert np.abs(roll).max() > 0.01


@pytest.mark.parametrize("text", ["2026-11-21T10:15:00.5+01:00", "run"])
def test_the_file_begins_at_the_time_of_take_off(run, flown, text: str) -> None:
    at = began(flown.folder) if text == "run" else datetime(2026, 11, 21, 9, 15, 0, 500_000, tzinfo=UTC)
    begin_ns = (at - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
    end_ns = begin_ns + round(flown.summary["sim_time_s"] * 1e9)
    folder = str(flown.folder)
    assert run("export", folder, "--mcap", "r.mcap", "--rosbag", "bag", "--take-off", text, "--quiet")[0] == EXIT_DONE
    times = []
    for topic, at_ns, message in read("r.mcap"):
        times.append(at_ns)
        if topic == "/tf":
            stamps = [one.header.stamp for one in message.transforms]
        elif topic in ("/swarm/poses", "/swarm/states", "/diagnostics"):
            stamps = [message.header.stamp]
        elif topic == "/rosout":
            stamps = [message.stamp]
        else:
            continue
        assert {stamp.sec * 10**9 + stamp.nanosec for stamp in stamps} == {at_ns}
    assert (times[0], times[-1]) == (begin_ns, end_ns)
    with Reader("bag") as bag:
        assert (bag.start_time, bag.end_time - 1) == (begin_ns, end_ns)


@pytest.mark.parametrize("text", ["2026-11-21T10:15:00", "noon", "1969-12-31T23:00:00Z", "2038-01-19T03:14:08Z", ""])
def test_a_time_of_take_off_that_is_none_is_refused(run, flown, text: str) -> None:
    code, _, err = run("export", str(flown.folder), "--mcap", "r.mcap", "--take-off", text)
    assert (code, f"--take-off {text}: give a time with a time zone" in err) == (EXIT_BAD_INPUT, True)
    assert not Path("r.mcap").exists()


@pytest.mark.parametrize("write", [write_mcap, write_bag])
def test_a_flight_is_read_in_pieces_and_an_interrupted_file_leaves_nothing(tmp_path, monkeypatch, flown, write) -> None:
    one, target = tmp_path / "one" / "r", tmp_path / "many" / "r"
    one.parent.mkdir()
    target.parent.mkdir()
    write(FlightSoFar(flown.folder), one, lambda *_: None)
    monkeypatch.setattr(flown_flights, "_PIECE_STATES", 100)
    for error, expected in ((KeyboardInterrupt(), KeyboardInterrupt), (OSError(errno.ENOSPC, "full"), RunFailed)):
        done = []

        def stop(ticks: int, _all: int, done=done, error=error) -> None:
            done.append(ticks)
            if len(done) == 5:
                raise error

        with pytest.raises(expected):
            write(FlightSoFar(flown.folder), target, stop)
        assert (done, list(target.parent.iterdir())) == ([20, 40, 60, 80, 100], [])
    write(FlightSoFar(flown.folder), target, lambda *_: None)
    for file in one.rglob("*") if one.is_dir() else (one,):
        assert file.read_bytes() == (target / file.relative_to(one)).read_bytes()


def test_of_an_unfinished_run_the_flown_part_is_written(run, tmp_path, flown) -> None:
    (flown.folder / "summary.json").rename(tmp_path / "summary.json")
    code, out, err = run("export", str(flown.folder), "--rosbag", "bag", "--quiet")
    (tmp_path / "summary.json").rename(flown.folder / "summary.json")
    assert (code, out) == (EXIT_DONE, "bag\n")
    assert err == f"{flown.folder}: the run did not finish; this is the flight up to tick 200\n"


def test_the_radio_of_a_flight_says_what_became_of_every_upload(run, tmp_path: Path) -> None:
    keys = {"federation.fraction": 0.8, "federation.period": 50, "federation.fragment": 1, "federation.retries": 1}
    flight = mf.fly("lossy", uavs=6, duration=30, seed=2, out=tmp_path, **keys)
    code, printed, _ = run("export", str(flight.folder), "--radio", "out/radio.json", "--quiet")
    assert (code, printed) == (EXIT_DONE, "out/radio.json\n")
    table = json.loads(Path("out/radio.json").read_text())
    assert (table["uavs"], table["round_s"]) == (6, 5.0)
    by_round = Counter(one["round"] for one in table["uploads"])
    rounds = flight.rounds().to_pylist()
    assert by_round == {row["round"]: row["sent"] for row in rounds}
    for row in rounds:
        of_round = [one for one in table["uploads"] if one["round"] == row["round"]]
        assert sum(one["arrived"] > 0 for one in of_round) == row["received"]
        assert all((one["delay_s"] is None) == (one["arrived"] == 0) for one in of_round)
    assert {one["arrived"] for one in table["uploads"]} - {0.0, 1.0}  # some in part
    code, _, error = run(
        "export", str(mf.fly(method="hjb", uavs=2, duration=2, out=tmp_path).folder), "--radio", "r.json"
    )
    assert code == EXIT_BAD_INPUT
    assert "no model was uploaded in this run" in error


def test_the_radio_of_a_flight_with_a_plugin_in_a_file_is_written(run, tmp_path: Path) -> None:
    trim = Path(__file__).parents[2] / "examples" / "trim.py"
    settings = {"method": "trim", "federation.period": 50}
    flight = mf.fly("lossy", uavs=6, duration=12, out=tmp_path, plugin=str(trim), **settings)
    registry.registered.clear()  # a new process, that was not told of the file
    command = ("export", str(flight.folder), "--radio", "radio.json")
    code, _, error = run(*command)
    assert code == EXIT_BAD_INPUT
    copy = flight.folder / "plugins" / "trim.py"
    assert error.endswith(f"name that: meanflock {' '.join(command)} --plugin {copy}\n")
    assert run(*command, "--plugin", str(copy), "--quiet")[:2] == (EXIT_DONE, "radio.json\n")
    assert len(json.loads(Path("radio.json").read_text())["uploads"]) == sum(flight.rounds()["sent"].to_pylist())
