"""A flight as a bag of ROS 2: rosbag2 with MCAP storage, messages in CDR."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from meanflock.export.instants import MAP, NANOSECONDS, Instant, about, instants, name, time_ns
from meanflock.results.event_log import event_level, event_text
from meanflock.results.flown import Flight, Piece
from meanflock.results.series import diagnostics_in
from meanflock.swarm import durable
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.wire.messages import Status

POSES = "/swarm/poses"
STATES = "/swarm/states"
DIAGNOSTICS = "/diagnostics"
EVENTS = "/rosout"
TYPES = {
    POSES: "geometry_msgs/msg/PoseArray",
    STATES: "sensor_msgs/msg/MultiDOFJointState",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
    EVENTS: "rcl_interfaces/msg/Log",
}
_PARTS = {  # of these messages, by package
    "builtin_interfaces": "Time",
    "diagnostic_msgs": "DiagnosticArray DiagnosticStatus KeyValue",
    "geometry_msgs": "Point Pose PoseArray Quaternion Transform Twist Vector3",
    "rcl_interfaces": "Log",
    "sensor_msgs": "MultiDOFJointState",
    "std_msgs": "Header",
}

_VERSION: Literal[8] = 8  # of the bag: written since Iron, read by later distributions too
_DIAGNOSED_NS = NANOSECONDS  # between two diagnostics, unless a status changes


def write_bag(flight: Flight, path: Path, progress: Callable[[int, int], None]) -> None:
    """Write a flight to a new folder; nothing is at `path` before the bag is complete.

    Args:
        progress: called with the ticks written and all ticks.

    Raises:
        BadInput: the time series is damaged, or no folder can be made there.
        RunFailed: the disk is full.
    """
    with _new_folder(path) as part:
        writer = Writer(part, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, value in about(flight.scenario, flight.finished).items():
            writer.set_custom_data(f"meanflock.{key}", value)
        with writer:
            export = _Export(writer, flight)
            done = 0
            for piece in flight.pieces():
                export.write(piece)
                done += len(piece.rows)
                progress(done, flight.ticks)


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """Context with the path of a folder to make, of the same name, that is moved to `path` at its end.

    An exception (Ctrl-C included) leaves nothing.

    Raises:
        BadInput: no folder can be made there. RunFailed: the disk is full or gone.
    """
    outer = path.with_name(f".{path.name}.part")
    shutil.rmtree(outer, ignore_errors=True)
    try:
        outer.mkdir()
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; name a new folder in one that can be written") from error
    try:
        part = outer / path.name
        yield part
        for file in part.iterdir():
            with file.open("rb") as written:
                os.fsync(written.fileno())
        durable.sync_folder(part)
        os.rename(part, path)
        durable.sync_folder(path.parent)
    except OSError as error:
        raise RunFailed(f"{path}: {error.strerror}; make room and repeat the command") from error
    finally:
        shutil.rmtree(outer, ignore_errors=True)


class _Export:
    """The topics of the bag."""

    def __init__(self, writer: Writer, flight: Flight) -> None:
        self._store = get_typestore(Stores.ROS2_KILTED)
        self._writer = writer
        self._connections = {
            topic: writer.add_connection(topic, kind, typestore=self._store) for topic, kind in TYPES.items()
        }
        self._make: dict[str, Any] = {
            kind: self._store.types[f"{package}/msg/{kind}"]
            for package, kinds in _PARTS.items()
            for kind in kinds.split()
        }
        self._flight = flight
        self._names = [name(uav) for uav in range(flight.scenario.uavs)]
        self._diagnosed: tuple[int, list[int]] = (-_DIAGNOSED_NS, [])  # time and status of the last diagnostics
        self._totals = [column.name for column in flight.columns if not pa.types.is_list(column.type)]
        self._per_uav = ["energy_J", *diagnostics_in(flight.columns)]

    def write(self, piece: Piece) -> None:
        """Append the ticks and events of a piece."""
        for at in instants(self._flight, piece):
            for event in at.events:
                self._event(event)
            self._states(at)
            last_ns, status = self._diagnosed
            if at.time_ns - last_ns >= _DIAGNOSED_NS or at.status != status:
                self._diagnosed = at.time_ns, at.status
                self._diagnose(at, piece)

    def _log(self, topic: str, time_ns: int, message: Any) -> None:
        content = self._store.serialize_cdr(message, TYPES[topic])
        self._writer.write(self._connections[topic], time_ns, content)

    def _time(self, time_ns: int) -> Any:
        return self._make["Time"](*divmod(time_ns, NANOSECONDS))

    def _states(self, at: Instant) -> None:
        make = self._make
        vector, pose, point, transform, twist = (
            make[kind] for kind in ("Vector3", "Pose", "Point", "Transform", "Twist")
        )
        header = make["Header"](self._time(at.time_ns), MAP)
        turns = [make["Quaternion"](0.0, 0.0, z, w) for z, w in at.headings]
        still = vector(0.0, 0.0, 0.0)
        poses = [pose(point(x, y, 0.0), turn) for (x, y, _, _), turn in zip(at.states, turns, strict=True)]
        transforms = [transform(vector(x, y, 0.0), turn) for (x, y, _, _), turn in zip(at.states, turns, strict=True)]
        twists = [twist(vector(vx, vy, 0.0), still) for _, _, vx, vy in at.states]
        self._log(POSES, at.time_ns, make["PoseArray"](header, poses))
        self._log(STATES, at.time_ns, make["MultiDOFJointState"](header, self._names, transforms, twists, []))

    def _diagnose(self, at: Instant, piece: Piece) -> None:
        (row,) = piece.rows.slice(at.row, 1).select(self._totals + self._per_uav).to_pylist()
        statuses = [self._diagnostic("swarm", "", 0, {key: row[key] for key in self._totals})]
        for uav, status in enumerate(map(Status, at.status)):
            level = 2 if status == Status.LOST else 0  # ERROR, OK
            values = {key: row[key][uav] for key in self._per_uav}
            statuses.append(self._diagnostic(self._names[uav], status.name.lower(), level, values))
        header = self._make["Header"](self._time(at.time_ns), MAP)
        self._log(DIAGNOSTICS, at.time_ns, self._make["DiagnosticArray"](header, statuses))

    def _diagnostic(self, subject: str, message: str, level: int, values: dict[str, Any]) -> Any:
        pairs = [self._make["KeyValue"](key, "" if value is None else str(value)) for key, value in values.items()]
        return self._make["DiagnosticStatus"](level, f"meanflock: {subject}", message, subject, pairs)

    def _event(self, event: FlightEvent) -> None:
        make = self._make["Log"]
        at_ns = time_ns(self._flight, event.tick * self._flight.scenario.dt)
        level = getattr(make, event_level(event))
        message = make(self._time(at_ns), level, f"meanflock.{event.kind}", event_text(event), "", "", 0)
        self._log(EVENTS, at_ns, message)
