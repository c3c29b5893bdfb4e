"""The mission of a scenario: start, launch time and goal of each UAV, and the obstacles. Pure functions."""

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.state import Floats

GRIDS = ("grid", "waves")  # formations with neighbours at the distance `start.spacing`
_LANES = 4  # of a stream


class Mission(Protocol):
    """The parts of a scenario that define a mission."""

    @property
    def uavs(self) -> int:
        """N, number of UAVs."""

    @property
    def dt(self) -> float:
        """Length of a tick, s."""

    @property
    def start(self) -> Any:
        """`[start]`."""

    @property
    def destination(self) -> Any:
        """`[destination]`."""

    @property
    def metrics(self) -> Any:
        """`[metrics]`."""

    @property
    def obstacles(self) -> Any:
        """`[[obstacles]]`."""

    @property
    def stations(self) -> Any:
        """`[[stations]]`."""


def starts(mission: Mission) -> state.States:
    """Initial states, (N, 4) in m and m/s. All UAVs are at rest."""
    start = mission.start
    places = np.array(start.positions, dtype=np.float64) if start.positions else _positions(start, mission.uavs)
    return state.at_rest(places)


def formation(start: Any) -> str:
    """The formation of a `[start]`; the default is the paper's grid."""
    name: str | None = start.formation
    return name or "grid"


def _positions(start: Any, uavs: int) -> Floats:
    """Positions of the UAVs of a formation, (N, 2) in m.

    grid: a centred square, ⌈√N⌉ = w wide: UAV k stands in column k mod w and row k div w, so the last row may be short.
    waves: the same with `start.group` columns, so a wave is a row.
    circle: evenly on a circle of `start.radius`, UAV 0 at angle 0.
    streams: two streams, each four UAVs abreast, that cross in the centre. The first ⌈N/2⌉ UAVs fly along x, the others
    along y; each stream begins around a point `start.radius` before the centre.
    """
    kind, centre = formation(start), np.array(start.centre)
    if kind == "circle":
        angle = 2.0 * math.pi * np.arange(uavs) / uavs
        return centre + start.radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    if kind == "streams":
        heading = _headings(uavs)
        first = -(-uavs // 2)
        along = [_stream(count, start.spacing) for count in (first, uavs - first)]
        offset = np.concatenate([along[0], along[1][:, ::-1]])  # the second stream, along y
        return centre - start.radius * heading + offset
    width = start.group if kind == "waves" else math.isqrt(uavs - 1) + 1
    number, placed = np.arange(uavs), np.empty((uavs, 2))
    last_row = (uavs - 1) // width
    placed[:, 0] = start.centre[0] + start.spacing * (number % width - (width - 1) / 2)
    placed[:, 1] = start.centre[1] + start.spacing * (number // width - last_row / 2)
    return placed


def _headings(uavs: int) -> Floats:
    """Unit vectors of two streams, (N, 2): the first ⌈N/2⌉ UAVs along x, the others along y."""
    first = np.arange(uavs) < -(-uavs // 2)
    return np.stack([first, ~first], axis=-1).astype(np.float64)


def _stream(uavs: int, spacing: float) -> Floats:
    """A stream along x about the origin, (n, 2): four abreast, row after row, the foremost first."""
    number, rows = np.arange(uavs), -(-uavs // _LANES)
    along = spacing * ((rows - 1) / 2 - number // _LANES)
    return np.stack([along, spacing * (number % _LANES - (_LANES - 1) / 2)], axis=-1)


def goals(mission: Mission) -> state.Vectors:
    """Goal of each UAV, (N, 2) in m. By default the origin is the goal of all.

    `opposite`: the start mirrored in `start.centre`. `across`: the other side of the crossing, in the formation of the
    stream. `parallel`: the whole formation moved from `start.centre` to the origin.
    """
    destination, start = mission.destination, mission.start
    if destination.positions:
        return np.array(destination.positions, dtype=np.float64)
    from_there = state.position(starts(mission))
    if destination.goals == "opposite":
        return 2.0 * np.array(start.centre) - from_there
    if destination.goals == "across":
        return from_there + 2.0 * start.radius * _headings(mission.uavs)
    if destination.goals == "parallel":
        return from_there - np.array(start.centre)
    return np.zeros(from_there.shape)


def goal_states(mission: Mission) -> state.States:
    """Goals as states at rest, (N, 4). A controller that flies to the origin needs the state minus its goal."""
    return state.at_rest(goals(mission))


def launches(mission: Mission) -> NDArray[np.intp]:
    """Tick in which each UAV leaves the ground, (N,). Wave w of `start.group` UAVs leaves w·`start.interval` later."""
    wave = np.arange(mission.uavs) // mission.start.group
    return np.rint(wave * mission.start.interval / mission.dt).astype(np.intp)


def obstacles(mission: Mission) -> Floats:
    """Obstacles, (K, 3): x, y and radius of each disc in m."""
    return np.array([(*disc.centre, disc.radius) for disc in mission.obstacles], dtype=np.float64).reshape(-1, 3)


def stations(mission: Mission) -> Floats:
    """Places of the stations, (B, 3) in m."""
    return np.array([station.place for station in mission.stations], dtype=np.float64).reshape(-1, 3)


def check(mission: Mission) -> None:
    """Raises ValueError if parts of the mission contradict each other, or if a start or goal is inside an obstacle."""
    _check_tables(mission)
    discs = obstacles(mission)
    if len(discs):
        remedy = "move one of them"
        for verb, places in (("starts", state.position(starts(mission))), ("has its goal", goals(mission))):
            for number, (x, y, radius) in enumerate(discs.tolist()):
                inside = np.flatnonzero(np.hypot(*(state.flat(places) - (x, y)).T) <= radius)
                if len(inside):
                    raise ValueError(f"UAV {inside[0]} {verb} inside `obstacles[{number}]`; {remedy}")
    if mission.start.positions or formation(mission.start) not in GRIDS:
        _check_apart(mission)


def _check_tables(mission: Mission) -> None:
    start = mission.start
    destination = mission.destination
    uavs = mission.uavs
    for name, table, other in (("start", start, "formation"), ("destination", destination, "goals")):
        if table.positions and getattr(table, other) is not None:
            raise ValueError(f"`{name}.positions` and `{name}.{other}` are both given; leave one of them out")
        if table.positions and len(table.positions) != uavs:
            raise ValueError(f"`{name}.positions` has {len(table.positions)} places for {uavs} UAVs; list one for each")
    if destination.goals == "across" and formation(start) != "streams":
        raise ValueError('`destination.goals` "across" needs streams; set `start.formation` to streams, or other goals')


def _check_apart(mission: Mission) -> None:
    """Raises ValueError if two UAVs that leave at the same time start within the collision radius.

    Grids are not checked: their spacing is a key of its own, and their collisions are counted.
    """
    places, least = state.position(starts(mission)), mission.metrics.collision_radius
    when = launches(mission)
    order = np.argsort(places[:, 0], kind="stable")
    ascending, ticks = places[order], when[order]
    for ahead in range(1, mission.uavs):
        step = ascending[ahead:] - ascending[:-ahead]
        if not (step[:, 0] < least).any():
            return
        near = ((step * step).sum(axis=-1) < least * least) & (ticks[ahead:] == ticks[:-ahead])
        if near.any():
            at = int(np.flatnonzero(near)[0])
            first, second = sorted((int(order[at]), int(order[at + ahead])))
            apart = float(np.hypot(*(places[first] - places[second])))
            raise ValueError(
                f"UAV {first} and UAV {second} start {apart:g} m apart, nearer than `metrics.collision_radius` "
                f"{least:g} m; move them apart, or take fewer UAVs"
            )
