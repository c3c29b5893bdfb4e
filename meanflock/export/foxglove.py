"""A flight as an MCAP file with the schemas of Foxglove."""

import math
from collections.abc import Callable
from io import FileIO
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from meanflock.export.columns import field_name, message_class
from meanflock.export.instants import MAP, NANOSECONDS, Instant, about, instants, label, name, time_ns
from meanflock.results.event_log import event_level, event_text
from meanflock.results.flown import Flight, Piece
from meanflock.results.run_folder import SCENARIO, SUMMARY
from meanflock.results.series import per_uav
from meanflock.swarm import __version__, durable, mission, paths
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.wire.messages import Status

TRANSFORMS = "/tf"
UAVS = "/uavs"
MISSION = "/mission"
EVENTS = "/events"
SWARM = "/swarm"
SERIES = "/series"

_COLORS = {  # red, green, blue
    Status.FLYING: (0.26, 0.56, 0.96),
    Status.ARRIVED: (0.20, 0.73, 0.40),
    Status.LOST: (0.85, 0.25, 0.22),
}
_GOAL, _OBSTACLE = (0.20, 0.73, 0.40), (0.55, 0.55, 0.58)
_LENGTH_M = 4.0  # of the arrow of a UAV
_HEIGHT_M = 4.0  # of an obstacle
_FONT_PX = 12.0
_DERIVED = (pa.field("lost", pa.int32()), pa.field("energy_mean_J", pa.float64()))  # not in the time series


def write_mcap(flight: Flight, path: Path, progress: Callable[[int, int], None]) -> None:
    """Write a flight; nothing is at `path` before the file is complete.

    Args:
        progress: called with the ticks written and all ticks.

    Raises:
        BadInput: the time series is damaged, or no file can be made there.
        RunFailed: the disk is full.
    """
    with durable.replacing(path) as file:
        export = _Export(file, flight)
        done = 0
        for piece in flight.pieces():
            export.write(piece)
            done += len(piece.rows)
            progress(done, flight.ticks)
        export.finish()


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
    """The channels of the file, and what they hold so far."""

    def __init__(self, file: FileIO, flight: Flight) -> None:
        self._writer = Writer(cast(Any, _Whole(file)))  # it calls nothing else
        self._writer.start(library=f"meanflock {__version__}")
        self._flight = flight
        lists = [field for field in flight.columns if pa.types.is_list(field.type)]
        each = [field for field in lists if field.name != "leader_model"]
        totals = [field for field in flight.columns if not pa.types.is_list(field.type)]
        self._each, self._totals = [field.name for field in each], [field.name for field in totals]
        self._series_message = message_class("Series", each)
        self._swarm_message = message_class("Swarm", [*totals, *_DERIVED])
        topics = {
            TRANSFORMS: FrameTransforms,
            UAVS: SceneUpdate,
            MISSION: SceneUpdate,
            EVENTS: Log,
            SERIES: self._series_message,
            SWARM: self._swarm_message,
        }
        schemas = {kind: register_schema(self._writer, kind) for kind in dict.fromkeys(topics.values())}
        self._channels = {
            topic: self._writer.register_channel(topic, "protobuf", schemas[kind]) for topic, kind in topics.items()
        }
        self._names = [name(uav) for uav in range(flight.scenario.uavs)]
        self._shown: list[int] = []  # the status of each UAV in the last scene
        self._log(MISSION, flight.take_off_ns, SceneUpdate(entities=_mission(flight)))

    def write(self, piece: Piece) -> None:
        """Append the ticks and events of a piece."""
        series = {field_name(name): per_uav(piece.rows, name)[..., 0].tolist() for name in self._each}
        swarm = {name: [math.nan if n is None else n for n in piece.rows[name].to_pylist()] for name in self._totals}
        swarm["lost"] = [status.count(Status.LOST) for status in series["status"]]
        swarm["energy_mean_J"] = [sum(energy) / len(energy) for energy in series["energy_J"]]
        for at in instants(self._flight, piece):
            for event in at.events:
                self._event(event)
            self._log(TRANSFORMS, at.time_ns, self._transforms(at))
            if at.status != self._shown:  # the frames move the UAVs, so the scene is written again only here
                self._shown = at.status
                self._log(UAVS, at.time_ns, _uavs(at))
            self._log(SERIES, at.time_ns, self._series_message(**{key: rows[at.row] for key, rows in series.items()}))
            self._log(SWARM, at.time_ns, self._swarm_message(**{key: rows[at.row] for key, rows in swarm.items()}))

    def finish(self) -> None:
        """Attach the scenario and the summary, and complete the file."""
        for file, kind in ((SCENARIO, "application/toml"), (SUMMARY, "application/json")):
            path = self._flight.folder / file
            if path.is_file():
                at_ns = self._flight.take_off_ns
                self._writer.add_attachment(at_ns, at_ns, file, kind, paths.read(path))
        self._writer.add_metadata("meanflock", about(self._flight.scenario, self._flight.finished))
        self._writer.finish()

    def _log(self, topic: str, time_ns: int, message: Message) -> None:
        self._writer.add_message(self._channels[topic], time_ns, message.SerializeToString(), time_ns)

    def _transforms(self, at: Instant) -> FrameTransforms:
        message = FrameTransforms()
        seconds, nanos = divmod(at.time_ns, NANOSECONDS)
        for child, (x, y, _, _), (z, w) in zip(self._names, at.states, at.headings, strict=True):
            transform = message.transforms.add(parent_frame_id=MAP, child_frame_id=child)
            transform.timestamp.seconds = seconds
            transform.timestamp.nanos = nanos
            transform.translation.x = x
            transform.translation.y = y
            transform.rotation.z = z
            transform.rotation.w = w
        return message

    def _event(self, event: FlightEvent) -> None:
        at_ns = time_ns(self._flight, event.tick * self._flight.scenario.dt)
        level = Log.Level.Value({"WARN": "WARNING"}.get(severity := event_level(event), severity))
        message = Log(level=level, message=event_text(event), name=event.kind)
        _stamp(message.timestamp, at_ns)
        self._log(EVENTS, at_ns, message)


def _stamp(timestamp: Any, time_ns: int) -> None:
    timestamp.seconds, timestamp.nanos = divmod(time_ns, NANOSECONDS)


def _uavs(at: Instant) -> SceneUpdate:
    """All UAVs, each in its own frame: a viewer that jumps to another time shows the last message of a topic alone."""
    message = SceneUpdate()
    for uav, status in enumerate(at.status):
        entity = message.entities.add(id=name(uav), frame_id=name(uav), frame_locked=True)
        _show(entity, at.time_ns)
        arrow = entity.arrows.add(
            shaft_length=_LENGTH_M / 2,
            shaft_diameter=_LENGTH_M / 6,
            head_length=_LENGTH_M / 2,
            head_diameter=_LENGTH_M / 3,
            color=_color(_COLORS[Status(status)]),
        )
        arrow.pose.position.x = 0.0  # a viewer may expect every part of a message
        arrow.pose.orientation.w = 1.0
        _add_text(entity, label(uav, status), _COLORS[Status(status)])
    return message


def _mission(flight: Flight) -> list[SceneEntity]:
    """Goals and obstacles."""
    flown = flight.scenario
    goals = np.unique(mission.goals(flown), axis=0).tolist()
    radius = flown.destination.radius
    discs = [(f"goal_{number}", x, y, radius, 0.1, _GOAL, 0.4) for number, (x, y) in enumerate(goals)]
    for number, (x, y, width) in enumerate(mission.obstacles(flown).tolist()):
        discs.append((f"obstacle_{number}", x, y, width, _HEIGHT_M, _OBSTACLE, 0.6))
    entities = []
    for title, x, y, width, height, color, alpha in discs:
        entity = SceneEntity(id=title, frame_id=MAP)
        _show(entity, flight.take_off_ns)
        disc = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0, color=_color(color, alpha))
        disc.pose.position.x = x
        disc.pose.position.y = y
        disc.pose.orientation.w = 1.0
        disc.size.x = disc.size.y = 2 * width
        disc.size.z = height
        entities.append(entity)
    if len(goals) == 1:
        _add_text(entities[0], "goal", _GOAL)
        entities[0].texts[0].pose.position.x, entities[0].texts[0].pose.position.y = goals[0]
    return entities


def _show(entity: SceneEntity, time_ns: int) -> None:
    """Show an entity from a time on, until the next scene."""
    _stamp(entity.timestamp, time_ns)
    _stamp(entity.lifetime, 0)


def _add_text(entity: SceneEntity, words: str, color: tuple[float, float, float]) -> None:
    text = entity.texts.add(text=words, font_size=_FONT_PX, billboard=True, scale_invariant=True, color=_color(color))
    text.pose.position.z = _LENGTH_M / 2
    text.pose.orientation.w = 1.0


def _color(shade: tuple[float, float, float], alpha: float = 1.0) -> Color:
    red, green, blue = shade
    return Color(r=red, g=green, b=blue, a=alpha)
