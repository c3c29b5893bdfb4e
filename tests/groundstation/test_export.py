"""`export`: the files that Foxglove and ROS 2 read, judged by the reader of each format."""

import errno
from collections import Counter
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from meanflock.results.flown import Flight
from meanflock.results.stored_run import began
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

import meanflock as mf
from meanflock.export.foxglove import write_mcap
from meanflock.export.rosbag import write_bag
from meanflock.results import flown as flown_flights
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, RunFailed

KILL = {"kind": "kill", "time_s": 3.0, "uavs": [2]}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> mf.Run:
    """A flight in which UAV 2 is lost, with a folder."""
    out = tmp_path_factory.mktemp("flown")
    return mf.fly(
        "paper", uavs=5, duration=20, seed=7, faults=[KILL], obstacles=[{"centre": [9, 9], "radius": 2}], out=out
    )


def test_foxglove_gets_every_state_with_its_bits_and_every_event(run, tmp_path, flown) -> None:
    assert run("export", str(flown.folder), "--mcap", "out/r.mcap", "--quiet") == (EXIT_DONE, "out/r.mcap\n", "")
    places, series, swarm, scenes, told = [], [], [], [], []
    kinds = {"/tf": places, "/series": series, "/swarm": swarm, "/uavs": scenes, "/events": told, "/mission": []}
    with Path("out/r.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            kinds[channel.topic].append(decoded)
            if channel.topic == "/tf":
                assert message.log_time == round((len(places) - 1) * flown.scenario.dt * 1e9)
        assert [file.name for file in reader.iter_attachments()] == ["scenario.toml", "summary.json"]
    at = np.array([[(t.translation.x, t.translation.y) for t in tick.transforms] for tick in places])
    assert at.tobytes() == flown.states[..., :2].tobytes()
    rows = flown.frame()
    for name in ("vx_m_s", "energy_J", "phi_G", "status"):
        assert [list(getattr(tick, name)) for tick in series] == rows[name].to_pylist()
    assert [tick.collisions for tick in swarm] == rows["collisions"].to_pylist()
    assert [tick.lost for tick in swarm] == [list(tick.status).count(2) for tick in series]
    labels = [[entity.texts[0].text for entity in scene.entities] for scene in scenes]
    assert labels == [["0", "1", "2", "3", "4"], ["0", "1", "2 lost", "3", "4"]]
    assert [event.name for event in told] == [event["kind"] for event in flown.events]
    ((mission,),) = (kinds["/mission"],)
    assert [entity.id for entity in mission.entities] == ["goal_0", "obstacle_0"]


def test_a_bag_has_every_state_with_its_bits(run, flown) -> None:
    assert run("export", str(flown.folder), "--rosbag", "bag", "--quiet")[0] == EXIT_DONE
    store = get_typestore(Stores.ROS2_JAZZY)  # another distribution than that of the writer
    counts, places, speeds = Counter(), [], []
    with Reader("bag") as reader:
        for connection, _, content in reader.messages():
            assert connection.digest == store.hash_rihs01(connection.msgtype)
            message = store.deserialize_cdr(content, connection.msgtype)
            counts[connection.topic] += 1
            if connection.topic == "/swarm/poses":
                places.append([(pose.position.x, pose.position.y) for pose in message.poses])
            elif connection.topic == "/swarm/states":
                speeds.append([(twist.linear.x, twist.linear.y) for twist in message.twist])
    assert np.concatenate([places, speeds], axis=-1).tobytes() == flown.states.tobytes()
    assert counts["/rosout"] == len(flown.events)
    assert counts["/diagnostics"] == 21  # one a second


@pytest.mark.parametrize("text", ["2026-11-21T10:15:00.5+01:00", "run"])
def test_both_formats_begin_at_the_time_of_take_off(run, flown, text: str) -> None:
    at = began(flown.folder) if text == "run" else datetime(2026, 11, 21, 9, 15, 0, 500_000, tzinfo=UTC)
    begin_ns = (at - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
    end_ns = begin_ns + round(flown.summary["sim_time_s"] * 1e9)
    folder = str(flown.folder)
    assert run("export", folder, "--mcap", "r.mcap", "--rosbag", "bag", "--take-off", text, "--quiet")[0] == EXIT_DONE
    with Path("r.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        stamped = [
            (channel.topic, message.log_time, decoded)
            for _, channel, message, decoded in reader.iter_decoded_messages()
        ]
    assert (stamped[0][1], stamped[-1][1]) == (begin_ns, end_ns)
    events = [(log_ns, decoded.timestamp) for topic, log_ns, decoded in stamped if topic == "/events"]
    assert all(stamp.seconds * 10**9 + stamp.nanos == log_ns for log_ns, stamp in events)
    ((goals,),) = ([decoded for topic, _, decoded in stamped if topic == "/mission"],)
    assert goals.entities[0].timestamp.seconds == begin_ns // 10**9
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader("bag") as bag:
        assert (bag.start_time, bag.end_time - 1) == (begin_ns, end_ns)
        for connection, log_ns, content in bag.messages():
            message = store.deserialize_cdr(content, connection.msgtype)
            stamp = message.stamp if connection.topic == "/rosout" else message.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == log_ns


@pytest.mark.parametrize("text", ["2026-11-21T10:15:00", "noon", "1969-12-31T23:00:00Z", ""])
def test_a_time_of_take_off_that_is_none_is_refused(run, flown, text: str) -> None:
    code, _, err = run("export", str(flown.folder), "--mcap", "r.mcap", "--take-off", text)
    assert (code, f"--take-off {text}: give a time with a time zone" in err) == (EXIT_BAD_INPUT, True)
    assert not Path("r.mcap").exists()


@pytest.mark.parametrize("write", [write_mcap, write_bag])
def test_a_flight_is_read_in_pieces_and_an_interrupted_file_leaves_nothing(tmp_path, monkeypatch, flown, write) -> None:
    one, target = tmp_path / "one" / "r", tmp_path / "many" / "r"
    one.parent.mkdir()
    target.parent.mkdir()
    write(Flight(flown.folder), one, lambda *_: None)
    monkeypatch.setattr(flown_flights, "_PIECE_STATES", 100)
    for error, expected in ((KeyboardInterrupt(), KeyboardInterrupt), (OSError(errno.ENOSPC, "full"), RunFailed)):
        done = []

        def stop(ticks: int, _all: int, done=done, error=error) -> None:
            done.append(ticks)
            if len(done) == 5:
                raise error

        with pytest.raises(expected):
            write(Flight(flown.folder), target, stop)
        assert (done, list(target.parent.iterdir())) == ([20, 40, 60, 80, 100], [])
    write(Flight(flown.folder), target, lambda *_: None)
    for file in one.rglob("*") if one.is_dir() else (one,):
        assert file.read_bytes() == (target / file.relative_to(one)).read_bytes()


def test_of_an_unfinished_run_the_flown_part_is_written(run, tmp_path, flown) -> None:
    (flown.folder / "summary.json").rename(tmp_path / "summary.json")
    code, out, err = run("export", str(flown.folder), "--rosbag", "bag", "--quiet")
    (tmp_path / "summary.json").rename(flown.folder / "summary.json")
    assert (code, out) == (EXIT_DONE, "bag\n")
    assert err == f"{flown.folder}: the run did not finish; this is the flight up to tick 200\n"
