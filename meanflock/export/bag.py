"""A flight as an MCAP file of ROS 2 messages, which Foxglove and ROS 2 open, and as a bag: a folder with that file."""

import json
import os
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from io import FileIO
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from meanflock.export import messages
from meanflock.export.instants import NANOSECONDS, Instant, about, instants, time_ns
from meanflock.results.flown import FlightSoFar, Piece
from meanflock.results.run_folder import SCENARIO, SUMMARY
from meanflock.results.series import diagnostics_in, per_uav
from meanflock.swarm import __version__, durable, paths
from meanflock.swarm.errors import BadInput
from meanflock.swarm.wire.messages import Status

_VERSION = 8  # of the bag: written since Iron, read by later distributions too
_STORE = get_typestore(Stores.ROS2_KILTED)
_LAYOUT = _STORE.types["std_msgs/msg/MultiArrayLayout"]([], 0)  # of one dimension
_REPEATED_NS = NANOSECONDS  # between two scenes and two diagnostics, unless a status changes
_DERIVED = (pa.field("lost", pa.int32()), pa.field("energy_mean_J", pa.float64()))  # not in the time series
_NUMBERS = {pa.float32(): "Float32", pa.float64(): "Float64", pa.int32(): "Int32", pa.uint8(): "UInt8"}


def write_mcap(flight: FlightSoFar, path: Path, progress: Callable[[int, int], None]) -> None:
    """Write a flight to a file; nothing is at `path` before the file is complete.

    Args:
        progress: called with the ticks written and all ticks.

    Raises:
        BadInput: the time series is damaged, or no file can be made there.
        RunFailed: the disk is full.
    """
    with durable.replacing(path) as file:
        _write(flight, file, progress)


def write_bag(flight: FlightSoFar, path: Path, progress: Callable[[int, int], None]) -> None:
    """Write a flight to a new folder; nothing is at `path` before the bag is complete.

    The file in it is that of `write_mcap`. Arguments and errors are the same, too.
    """
    with _new_folder(path) as folder:
        name = f"{path.name}.mcap"
        with (folder / name).open("wb", buffering=0) as file:
            export = _write(flight, file, progress)
            os.fsync(file.fileno())
        durable.replace(folder / "metadata.yaml", export.metadata(name))


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """Context with a new folder that is renamed to `path` at its end, unless an exception (Ctrl-C included) deletes it.

    Raises:
        BadInput: no folder can be made there. RunFailed: the disk is full or gone.
    """
    part = path.with_name(f".{path.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir()
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; name a new folder in one that can be written") from error
    try:
        yield part
        durable.rename(part, path)
    except OSError as error:
        raise durable.not_written(path, error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _write(flight: FlightSoFar, file: FileIO, progress: Callable[[int, int], None]) -> "_Export":
    export = _Export(file, flight)
    done = 0
    for piece in flight.pieces():
        export.write(piece)
        done += len(piece.rows)
        progress(done, flight.ticks)
    export.finish()
    return export


class _Whole:
    """A file in which one call writes all of the content."""

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self.tell = file.tell
        self.flush = file.flush

    def write(self, content: bytes | memoryview) -> int:
        durable.write(self._file, content)
        return len(content)


class _Export:
    """The topics of the file, and the number and the times of their messages so far."""

    def __init__(self, file: FileIO, flight: FlightSoFar) -> None:
        self._writer = Writer(cast(Any, _Whole(file)))  # it calls nothing else
        self._writer.start(profile="ros2", library=f"meanflock {__version__}")
        self._flight = flight
        self._columns = [_column(field) for field in (*flight.columns, *_DERIVED) if field.name != "leader_model"]
        self._totals = [field.name for field in flight.columns if not pa.types.is_list(field.type)]
        self._reports = ["energy_J", *diagnostics_in(flight.columns)]
        self._schemas: dict[str, int] = {}  # number of each type of messages
        self._topics: dict[str, tuple[int, str]] = {}  # number of each channel, and its type
        self._counts: Counter[str] = Counter()
        self._first_ns = self._last_ns = flight.take_off_ns
        self._mission = _serialized(messages.goals_and_obstacles(flight.scenario))
        self._uavs = _serialized(messages.uavs([], [], flight.scenario))  # the last scene
        self._groups = [group.name for group in flight.scenario.groups for _ in range(group.count)]
        self._shown: tuple[int, list[int]] = (0, [])  # its time, and the status of each UAV

    def write(self, piece: Piece) -> None:
        """Append the ticks and events of a piece."""
        each = [field.name for field in self._flight.columns if pa.types.is_list(field.type)]
        values = {name: per_uav(piece.rows, name)[..., 0] for name in each if name != "leader_model"}
        values["lost"] = np.count_nonzero(values["status"] == Status.LOST, axis=1).tolist()
        values["energy_mean_J"] = values["energy_J"].mean(axis=1, dtype=np.float64).tolist()
        values |= {name: piece.rows[name].to_numpy().tolist() for name in self._totals}  # an unknown number is NaN
        for at in instants(self._flight, piece):
            for event in at.events:
                event_ns = time_ns(self._flight, event.tick * self._flight.scenario.dt)
                self._log("/rosout", event_ns, messages.event(event_ns, event))
            self._log("/tf", at.time_ns, messages.transforms(at))
            self._log("/swarm/poses", at.time_ns, messages.poses(at))
            self._log("/swarm/states", at.time_ns, messages.states(at))
            for name, topic, message in self._columns:
                self._log(topic, at.time_ns, message(values[name][at.row]))
            shown_ns, status = self._shown
            if at.time_ns - shown_ns >= _REPEATED_NS or at.status != status:
                self._show(at, piece)

    def _show(self, at: Instant, piece: Piece) -> None:
        """Append the scene and the diagnostics."""
        if at.status != self._shown[1]:  # else the frames alone move the UAVs
            self._uavs = _serialized(messages.uavs(at.uavs, at.status, self._flight.scenario))
        self._shown = at.time_ns, at.status
        self._append("/mission", at.time_ns, *self._mission)
        self._append("/uavs", at.time_ns, *self._uavs)
        (row,) = piece.rows.slice(at.row, 1).select(self._totals + self._reports).to_pylist()
        totals = {key: row.pop(key) for key in self._totals}
        row |= {"group": self._groups} if self._groups else {}
        self._log("/diagnostics", at.time_ns, messages.diagnostics(at, totals, row))

    def _log(self, topic: str, time_ns: int, message: Any) -> None:
        self._append(topic, time_ns, *_serialized(message))

    def _append(self, topic: str, time_ns: int, kind: str, content: bytes) -> None:
        if topic not in self._topics:
            self._add(topic, kind)
        self._writer.add_message(self._topics[topic][0], time_ns, content, time_ns)
        self._counts[topic] += 1
        self._first_ns, self._last_ns = min(self._first_ns, time_ns), max(self._last_ns, time_ns)

    def _add(self, topic: str, kind: str) -> None:
        if kind not in self._schemas:
            definition, _ = _STORE.generate_msgdef(kind, ros_version=2)
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", definition.encode())
        metadata = {"offered_qos_profiles": "", "topic_type_hash": _STORE.hash_rihs01(kind)}
        self._topics[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind], metadata), kind

    def finish(self) -> None:
        """Attach the scenario and the summary, and complete the file."""
        for file, kind in ((SCENARIO, "application/toml"), (SUMMARY, "application/json")):
            path = self._flight.folder / file
            if path.is_file():
                at_ns = self._flight.take_off_ns
                self._writer.add_attachment(at_ns, at_ns, file, kind, paths.read(path))
        self._writer.add_metadata("meanflock", about(self._flight.scenario, self._flight.finished))
        self._writer.finish()

    def metadata(self, file: str) -> bytes:
        """The metadata of a bag with the file of this name. They are JSON, which is YAML, too."""
        span = {
            "starting_time": {"nanoseconds_since_epoch": self._first_ns},
            "duration": {"nanoseconds": self._last_ns - self._first_ns},
            "message_count": self._counts.total(),
        }
        topics = [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": kind,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": "",
                    "type_description_hash": _STORE.hash_rihs01(kind),
                },
                "message_count": self._counts[topic],
            }
            for topic, (_, kind) in self._topics.items()
        ]
        scenario = about(self._flight.scenario, self._flight.finished)
        described = {
            "version": _VERSION,
            "storage_identifier": "mcap",
            "relative_file_paths": [file],
            "files": [{"path": file} | span],
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "custom_data": {f"meanflock.{key}": value for key, value in scenario.items()},
            "ros_distro": "",
        }
        return json.dumps({"rosbag2_bagfile_information": described | span}, indent=2).encode()


def _serialized(message: Any) -> tuple[str, bytes]:
    """The type of a message, and its bytes."""
    kind = message.__msgtype__
    return kind, bytes(_STORE.serialize_cdr(message, kind))


def _column(field: pa.Field) -> tuple[str, str, Callable[[Any], Any]]:
    """Name, topic and messages of a column of the time series; the topic is in ASCII: `φ` becomes `u03c6`."""
    title = re.sub(r"[^A-Za-z0-9_]", lambda letter: f"u{ord(letter[0]):04x}", field.name)
    if pa.types.is_list(field.type):
        array = _STORE.types[f"std_msgs/msg/{_NUMBERS[field.type.value_type]}MultiArray"]
        return field.name, f"/series/{title}", partial(array, _LAYOUT)
    return field.name, f"/swarm/{title}", _STORE.types[f"std_msgs/msg/{_NUMBERS[field.type]}"]
