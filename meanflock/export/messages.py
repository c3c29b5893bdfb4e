"""Messages of ROS 2 that show a flight. Their types are known to Foxglove and to every distribution from Humble on."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from rosbags.typesys.stores import ros2_kilted as ros

from meanflock.export.instants import NANOSECONDS, Instant
from meanflock.results import groups
from meanflock.results.event_log import event_level, event_text
from meanflock.swarm import mission, state
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.mission import Mission
from meanflock.swarm.wire.messages import Status

Color = tuple[float, float, float]  # red, green, blue

_MAP = "map"  # the frame of all positions: goal at the origin, x and y as in the scenario, z up
_COLORS: dict[Status, Color] = {
    Status.FLYING: (0.26, 0.56, 0.96),
    Status.ARRIVED: (0.20, 0.73, 0.40),
    Status.LOST: (0.85, 0.25, 0.22),
    Status.LANDED: (0.55, 0.55, 0.55),
}
_GROUPS: tuple[Color, ...] = (  # of UAVs of groups that fly or have arrived
    (0.26, 0.56, 0.96),
    (1.00, 0.71, 0.33),
    (0.73, 0.60, 1.00),
    (0.90, 0.90, 0.35),
    (1.00, 0.56, 0.64),
    (0.93, 0.94, 0.96),
)
_GOAL: Color = (0.20, 0.73, 0.40)
_OBSTACLE: Color = (0.55, 0.55, 0.58)
_STATION: Color = (0.93, 0.94, 0.96)
_LENGTH_M = 4.0  # of the arrow of a UAV
_HEIGHT_M = 4.0  # of an obstacle in the plane; in space, of one without an end, above all starts and goals
_MAST_M = 0.5  # radius of a station's cylinder
_LETTERS_M = 3.0  # height of the letters
_STILL = ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0)
_AHEAD = ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0)
_NEWEST = ros.builtin_interfaces__msg__Time(0, 0)  # in a marker: follow the newest position of its frame
_EMPTY = np.zeros(0, np.uint8)


def transforms(at: Instant) -> Any:
    """The frame of each UAV in the map."""
    header = _header(at.time_ns)
    each = [
        ros.geometry_msgs__msg__TransformStamped(header, _name(uav), transform)
        for uav, transform in zip(at.uavs, _transforms(at), strict=True)
    ]
    return ros.tf2_msgs__msg__TFMessage(each)


def poses(at: Instant) -> Any:
    """The pose of each UAV."""
    each = [
        ros.geometry_msgs__msg__Pose(ros.geometry_msgs__msg__Point(*place), _turn(turn))
        for place, turn in zip(at.places, at.turns, strict=True)
    ]
    return ros.geometry_msgs__msg__PoseArray(_header(at.time_ns), each)


def states(at: Instant) -> Any:
    """Name, transform and velocity over ground of each UAV."""
    names = [_name(uav) for uav in at.uavs]
    velocities = [
        ros.geometry_msgs__msg__Twist(ros.geometry_msgs__msg__Vector3(*velocity), _STILL) for velocity in at.velocities
    ]
    return ros.sensor_msgs__msg__MultiDOFJointState(_header(at.time_ns), names, _transforms(at), velocities, [])


def uavs(numbers: Sequence[int], status: Sequence[int], flown: Mission) -> Any:
    """An arrow and a label for each UAV, in its frame. Arrows of a group have its colour, and its name as namespace."""
    size = (_LENGTH_M, _LENGTH_M / 6, _LENGTH_M / 6)
    markers = []
    group = groups.numbers(flown)
    for uav, now, number in zip(numbers, map(Status, status), group[list(numbers)].tolist(), strict=True):
        label = str(uav) if now == Status.FLYING else f"{uav} {now.name.lower()}"
        arrow = ros.visualization_msgs__msg__Marker.ARROW
        color, namespace = _COLORS[now], "uavs"
        if flown.groups:
            namespace = flown.groups[number].name
            color = _GROUPS[number % len(_GROUPS)] if now < Status.LOST else color
        markers.append(_marker(namespace, uav, arrow, (0.0, 0.0, 0.0), size, color, frame=_name(uav)))
        markers.append(_text(uav, (0.0, 0.0, 0.0), label, color, frame=_name(uav)))
    return ros.visualization_msgs__msg__MarkerArray(markers)


def goals_and_obstacles(flown: Mission) -> Any:
    """A disc for each goal, the obstacles, and for each station a thin cylinder from the ground to its antenna."""
    goals = np.unique(state.in_three(mission.all_goals(flown)), axis=0).tolist()
    cylinder, width = ros.visualization_msgs__msg__Marker.CYLINDER, 2 * flown.destination.radius
    markers = [
        _marker("goals", number, cylinder, goal, (width, width, 0.1), _GOAL, 0.4) for number, goal in enumerate(goals)
    ]
    markers += [_obstacle(number, each, flown) for number, each in enumerate(flown.obstacles)]
    for number, (x, y, height) in enumerate(mission.stations(flown).tolist()):
        size = (2 * _MAST_M, 2 * _MAST_M, max(height, _MAST_M))
        markers.append(_marker("stations", number, cylinder, (x, y, height / 2), size, _STATION, 0.9))
    if len(goals) == 1:
        markers.append(_text(0, goals[0], "goal", _GOAL))
    return ros.visualization_msgs__msg__MarkerArray(markers)


def _obstacle(number: int, obstacle: Any, flown: Mission) -> Any:
    """A sphere, or a cylinder: in the plane around it, in space from the ground up.

    A column without an end is drawn a little higher than all starts and goals. The sides of a polygon are triangles.
    """
    x, y, *z = obstacle.centre or obstacle.disc[:2]
    width, kind = 2 * obstacle.radius, ros.visualization_msgs__msg__Marker
    if z:
        return _marker("obstacles", number, kind.SPHERE, (x, y, *z), (width, width, width), _OBSTACLE, 0.6)
    low, high = 0.0, obstacle.height
    if flown.space.dimensions == state.PLANE:
        low, high = -_HEIGHT_M / 2, _HEIGHT_M / 2
    elif high is None:
        places = np.concatenate([state.position(mission.starts(flown)), mission.all_goals(flown)])
        high = float(places[:, 2].max()) + _HEIGHT_M
    if obstacle.polygon:
        marker = _marker("obstacles", number, kind.TRIANGLE_LIST, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), _OBSTACLE, 0.6)
        marker.points.extend(ros.geometry_msgs__msg__Point(*place) for place in _sides(obstacle.polygon, low, high))
        return marker
    place, size = (x, y, (low + high) / 2), (width, width, high - low)
    return _marker("obstacles", number, kind.CYLINDER, place, size, _OBSTACLE, 0.6)


def _sides(corners: Sequence[tuple[float, float]], low: float, high: float) -> Iterator[tuple[float, float, float]]:
    """Corners of the triangles of a prism's sides, two for each side."""
    for (x0, y0), (x1, y1) in pairwise([*corners, corners[0]]):
        yield from ((x0, y0, low), (x1, y1, low), (x1, y1, high), (x0, y0, low), (x1, y1, high), (x0, y0, high))


def diagnostics(at: Instant, totals: Mapping[str, Any], reports: Mapping[str, Sequence[Any]]) -> Any:
    """The totals of the swarm, and the status and the reports of each UAV."""
    entries = [_diagnostic("swarm", "", 0, totals)]
    for uav, status in zip(at.uavs, map(Status, at.status), strict=True):
        level = 2 if status == Status.LOST else 0  # ERROR, OK
        values = {key: each[uav] for key, each in reports.items()}
        entries.append(_diagnostic(_name(uav), status.name.lower(), level, values))
    return ros.diagnostic_msgs__msg__DiagnosticArray(_header(at.time_ns), entries)


def event(time_ns: int, happened: FlightEvent) -> Any:
    """An event as a line of a log."""
    level = getattr(ros.rcl_interfaces__msg__Log, event_level(happened))
    subject = f"meanflock.{happened.kind}"
    return ros.rcl_interfaces__msg__Log(_time(time_ns), level, subject, event_text(happened), "", "", 0)


def _name(uav: int) -> str:
    """The name of a UAV, and of the frame that moves with it."""
    return f"uav_{uav}"


def _time(time_ns: int) -> Any:
    return ros.builtin_interfaces__msg__Time(*divmod(time_ns, NANOSECONDS))


def _header(time_ns: int) -> Any:
    return ros.std_msgs__msg__Header(_time(time_ns), _MAP)


def _turn(turn: Sequence[float]) -> Any:
    return ros.geometry_msgs__msg__Quaternion(*turn)


def _transforms(at: Instant) -> list[Any]:
    return [
        ros.geometry_msgs__msg__Transform(ros.geometry_msgs__msg__Vector3(*place), _turn(turn))
        for place, turn in zip(at.places, at.turns, strict=True)
    ]


def _diagnostic(subject: str, message: str, level: int, values: Mapping[str, Any]) -> Any:
    pairs = [
        ros.diagnostic_msgs__msg__KeyValue(key, "" if value is None else str(value)) for key, value in values.items()
    ]
    return ros.diagnostic_msgs__msg__DiagnosticStatus(level, f"meanflock: {subject}", message, subject, pairs)


def _text(number: int, place: Sequence[float], words: str, color: Color, frame: str = _MAP) -> Any:
    x, y, z = place
    kind, size = ros.visualization_msgs__msg__Marker.TEXT_VIEW_FACING, (0.0, 0.0, _LETTERS_M)
    return _marker("labels", number, kind, (x, y, z + _LENGTH_M / 2), size, color, text=words, frame=frame)


def _marker(
    namespace: str,
    number: int,
    kind: int,
    place: Sequence[float],
    size: tuple[float, float, float],
    color: Color,
    alpha: float = 1.0,
    text: str = "",
    frame: str = _MAP,
) -> Any:
    header = ros.std_msgs__msg__Header(_NEWEST, frame)
    return ros.visualization_msgs__msg__Marker(
        header=header,
        ns=namespace,
        id=number,
        type=kind,
        action=ros.visualization_msgs__msg__Marker.ADD,
        pose=ros.geometry_msgs__msg__Pose(ros.geometry_msgs__msg__Point(*place), _AHEAD),
        scale=ros.geometry_msgs__msg__Vector3(*size),
        color=ros.std_msgs__msg__ColorRGBA(*color, alpha),
        lifetime=ros.builtin_interfaces__msg__Duration(0, 0),  # until the next scene
        frame_locked=True,
        points=[],
        colors=[],
        texture_resource="",
        texture=ros.sensor_msgs__msg__CompressedImage(header, "", _EMPTY),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=ros.visualization_msgs__msg__MeshFile("", _EMPTY),
        mesh_use_embedded_materials=False,
    )
