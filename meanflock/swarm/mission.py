"""The mission of a scenario: start, launch time and goal of each UAV, and the obstacles. Pure functions."""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.polygons import Polygon
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
    def space(self) -> Any:
        """`[space]`."""

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

    @property
    def energy(self) -> Any:
        """`[energy]`."""

    @property
    def groups(self) -> Any:
        """`[[groups]]`."""


def parts(mission: Mission) -> Iterator[tuple[Any, slice]]:
    """The groups of a mission, each with the rows of its UAVs."""
    first = 0
    for group in mission.groups:
        yield group, slice(first, first + group.count)
        first += group.count


class FlownMission(Mission, Protocol):
    """A mission with its vehicle, which may read the starts from a file."""

    @property
    def vehicle(self) -> Any:
        """`[vehicle]`."""


def method(flown: Any) -> str:
    """Name of the controller of a scenario; of groups, those of all, joined by "+"."""
    return "+".join(dict.fromkeys(group.method or flown.method for group in flown.groups)) or str(flown.method)


def uavs_of(mission: Mission, radio: Any) -> list[int]:
    """The UAVs that an entry of `[[radios]]` names: by numbers, or by their group."""
    return [
        *radio.uavs,
        *(uav for group, rows in parts(mission) if group.name == radio.group for uav in range(rows.start, rows.stop)),
    ]


def starts(mission: Mission) -> state.States:
    """Initial states, (N, 2d) in m and m/s. All UAVs are at rest."""
    states = _starts(mission.uavs, mission.start, mission.space).copy()
    for group, rows in parts(mission):
        if group.start is not None:
            states[rows] = _starts(group.count, group.start, mission.space)
    return states


@lru_cache(maxsize=16)
def _starts(uavs: int, start: Any, space: Any) -> state.States:
    if start.positions:
        states = state.at_rest(space.vectors(start.positions, start.height))
    else:
        states = state.at_rest(_positions(start, uavs)[:, : space.dimensions])
    states.flags.writeable = False
    return states


def has_starts(mission: FlownMission) -> bool:
    """Returns whether the starts are known. They are not while a vehicle is still to read them from its file."""
    return all(start is not None and start.positions for start in recorded_starts(mission))


def recorded_starts(mission: FlownMission) -> list[Any]:
    """The `[start]` of all UAVs, and that of each group, whose vehicle reads the starts from its file."""
    tables = [(mission.vehicle, mission.start), *((group.vehicle, group.start) for group in mission.groups)]
    return [start for vehicle, start in tables if vehicle is not None and vehicle.file is not None]


def formation(start: Any) -> str:
    """The formation of a `[start]`; the default is the paper's grid."""
    name: str | None = start.formation
    return name or "grid"


def _positions(start: Any, uavs: int) -> Floats:
    """Positions of so many UAVs of a formation, (n, 3) in m.

    grid: a centred square in each layer, ⌈√n⌉ = w wide: UAV k of the layer's n stands in column k mod w and row
    k div w, so the last row may be short. UAVs fill the lowest layer first.
    waves: the same with `start.group` columns, so a wave is a row.
    circle: evenly on a level circle of `start.radius`, UAV 0 at angle 0.
    sphere: evenly on a sphere of `start.radius`, UAV 0 at the top.
    streams: two streams, each four UAVs abreast in each layer, that cross in the centre. The first ⌈N/2⌉ UAVs fly along
    x, the others along y; each stream begins around a point `start.radius` before the centre.
    """
    kind, centre = formation(start), np.array((*start.centre, start.height)[:3])
    if kind == "circle":
        angle = 2.0 * math.pi * np.arange(uavs) / uavs
        return centre + start.radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(uavs)], axis=-1)
    if kind == "sphere":
        return centre + start.radius * _sphere(uavs)
    if kind == "streams":
        first = -(-uavs // 2)
        along = [_stream(count, start.spacing, start.layers) for count in (first, uavs - first)]
        offset = np.concatenate([along[0], along[1][:, [1, 0, 2]]])  # the second stream, along y
        return centre - start.radius * _headings(uavs) + offset
    each = -(-uavs // start.layers)
    width = start.group if kind == "waves" else math.isqrt(each - 1) + 1
    each = -(-each // width) * width if kind == "waves" else each  # whole waves in a layer
    layer, number = np.divmod(np.arange(uavs), each)
    last_row = (min(each, uavs) - 1) // width
    middle = np.array([(width - 1) / 2, last_row / 2, layer[-1] / 2])  # of the layers that have UAVs
    return centre + start.spacing * (np.stack([number % width, number // width, layer], axis=-1) - middle)


def _headings(uavs: int) -> Floats:
    """Unit vectors of two streams, (N, 3): the first ⌈N/2⌉ UAVs along x, the others along y."""
    first = np.arange(uavs) < -(-uavs // 2)
    return np.stack([first, ~first, np.zeros(uavs)], axis=-1).astype(np.float64)


def _stream(uavs: int, spacing: float, layers: int) -> Floats:
    """A stream along x about the origin, (n, 3): rows of four abreast in each layer, the foremost first."""
    number, lane = np.divmod(np.arange(uavs), _LANES)
    row, layer = np.divmod(number, layers)
    rows = -(-uavs // (_LANES * layers))
    offsets = [(rows - 1) / 2 - row, lane - (_LANES - 1) / 2, layer - (layers - 1) / 2]
    return spacing * np.stack(offsets, axis=-1)


def _sphere(uavs: int) -> Floats:
    """Points of a Fibonacci lattice on the unit sphere, (N, 3): equal areas, from the top down in golden angles."""
    upward = 1.0 - (2.0 * np.arange(uavs) + 1.0) / uavs
    angle, across = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(uavs), np.sqrt(1.0 - upward * upward)
    return np.stack([across * np.cos(angle), across * np.sin(angle), upward], axis=-1)


def goals(mission: Mission) -> state.Vectors:
    """Goal of each UAV, (N, d) in m. By default the origin is the goal of all; in space, the point above it at
    `start.height`.

    `opposite`: the start mirrored in `start.centre`. `vertical`: mirrored in its height only. `across`: the other side
    of the crossing, in the formation of the stream. `parallel`: the whole formation moved from `start.centre` to the
    origin.
    """
    from_there = state.position(starts(mission))
    places = _goals(mission.space, mission.start, mission.destination, from_there)
    for group, rows in parts(mission):
        destination = group.destination or mission.destination
        if group.destination is None and (group.start is None or destination.positions):
            continue  # they have the goals of the flight
        if group.start is not None:
            places[rows] = _goals(mission.space, group.start, destination, from_there[rows])
        elif destination.positions:
            places[rows] = mission.space.vectors(destination.positions, mission.start.height)
        else:
            places[rows] = _goals(mission.space, mission.start, destination, from_there)[rows]
    return places


def _goals(space: Any, start: Any, destination: Any, from_there: state.Vectors) -> state.Vectors:
    """Goals by a `[destination]` of UAVs that start by a `[start]`, at the places `from_there` (n, d); likewise."""
    if destination.positions:
        return np.array(space.vectors(destination.positions, start.height))
    if destination.waypoints:
        return np.tile(space.vectors(destination.waypoints[:1], start.height), (len(from_there), 1))
    centre = space.vector(start.centre, start.height)
    if destination.goals == "opposite":
        return 2.0 * centre - from_there
    if destination.goals == "vertical":
        above, below = np.split(from_there, [state.PLANE], axis=-1)
        return np.concatenate([above, 2.0 * centre[state.PLANE :] - below], axis=-1)
    if destination.goals == "across":
        return from_there + 2.0 * start.radius * _headings(len(from_there))[:, : space.dimensions]
    origin = space.vector((0.0, 0.0), start.height)
    if destination.goals == "parallel":
        return from_there - (centre - origin)
    return np.tile(origin, (len(from_there), 1))


def destinations(mission: Mission) -> list[tuple[slice, Any]]:
    """The `[destination]` of all UAVs, by their rows."""
    if not mission.groups:
        return [(slice(0, mission.uavs), mission.destination)]
    return [(rows, group.destination or mission.destination) for group, rows in parts(mission)]


def vehicles(mission: FlownMission) -> list[tuple[Any, slice]]:
    """The `[vehicle]` of all UAVs, with their rows."""
    if not mission.groups:
        return [(mission.vehicle, slice(0, mission.uavs))]
    return [(group.vehicle or mission.vehicle, rows) for group, rows in parts(mission)]


def all_goals(mission: Mission) -> state.Vectors:
    """The goals of all UAVs, and all waypoints, (K, d) in m."""
    places = [goals(mission)]
    for _, destination in destinations(mission):
        if destination.waypoints:
            places.append(np.array(mission.space.vectors(destination.waypoints, mission.start.height)))
    return np.concatenate(places) if len(places) > 1 else places[0]


def farthest_from_landing(mission: Any) -> Floats:
    """The longest way of each UAV from a goal to the nearest landing place, or without any to its start, (N,), m.

    `mission`: a scenario.
    """
    home, first, space = state.position(starts(mission)), goals(mission), mission.space
    landings = np.array(space.vectors(mission.energy.landings, mission.start.height))
    farthest = np.zeros(mission.uavs)
    for rows, destination in destinations(mission):
        for place in [first[rows], *space.vectors(destination.waypoints, mission.start.height)]:
            apart = place - home[rows] if not len(landings) else np.atleast_2d(place)[:, None] - landings
            length = state.length(apart)
            farthest[rows] = np.maximum(farthest[rows], length.min(axis=1) if len(landings) else length)
    return farthest


def radii(mission: Mission) -> Floats:
    """Distance from its goal at which each UAV has arrived, (N,): `destination.radius`, or that of its group."""
    radius = np.full(mission.uavs, mission.destination.radius)
    for group, rows in parts(mission):
        if group.destination is not None:
            radius[rows] = group.destination.radius
    return radius


def in_space(mission: Mission, positions: state.Vectors) -> Floats:
    """Positions (N, d) of UAVs with their heights, (N, 3) in m: in the plane all fly at `start.height`."""
    if positions.shape[-1] == state.SPACE:
        return positions
    place = np.empty((len(positions), state.SPACE))  # half the time of `np.concatenate`
    place[:, : state.PLANE] = positions
    place[:, state.PLANE :] = mission.start.height
    return place


def goal_states(mission: Mission) -> state.States:
    """Goals as states at rest, (N, 2d). A controller that flies to the origin needs the state minus its goal."""
    return state.at_rest(goals(mission))


def launches(mission: Mission) -> NDArray[np.intp]:
    """Tick in which each UAV leaves the ground, (N,). Wave w of `start.group` UAVs leaves w·`start.interval` later, and
    no UAV leaves before its group joins."""
    ticks = _launches(mission.start, mission.uavs, mission.dt)
    for group, rows in parts(mission):
        if group.start is not None:
            ticks[rows] = _launches(group.start, group.count, mission.dt)
    return np.maximum(ticks, joins(mission))


def _launches(start: Any, uavs: int, dt: float) -> NDArray[np.intp]:
    return np.rint(np.arange(uavs) // start.group * start.interval / dt).astype(np.intp)


NEVER = np.iinfo(np.intp).max


def joins(mission: Mission) -> NDArray[np.intp]:
    """Tick in which the group of each UAV joins the flight, (N,)."""
    ticks = np.zeros(mission.uavs, dtype=np.intp)
    for group, rows in parts(mission):
        ticks[rows] = group.joins_in(mission.dt)
    return ticks


def leaves(mission: Mission) -> NDArray[np.intp]:
    """Tick in which the group of each UAV leaves the flight, (N,); `NEVER` for a group that stays."""
    ticks = np.full(mission.uavs, NEVER)
    for group, rows in parts(mission):
        if (tick := group.leaves_in(mission.dt)) is not None:
            ticks[rows] = tick
    return ticks


def obstacles(mission: Mission) -> Floats:
    """Obstacles as seen from above, (K, 3): x, y and radius of each in m; of a polygon, those of a disc around it."""
    return np.array([one.disc for one in mission.obstacles], dtype=np.float64).reshape(-1, 3)


def solids(mission: Mission) -> Floats:
    """Obstacles as `obstacles`; in space (K, 5), with the lowest and the highest point of their upright axes, m."""
    if mission.space.dimensions != state.SPACE:
        return obstacles(mission)
    axes = np.array([one.axis for one in mission.obstacles], dtype=np.float64).reshape(-1, 2)
    return np.concatenate([obstacles(mission), axes], axis=1)


def polygons(mission: Mission) -> dict[int, Polygon]:
    """The obstacles that are polygons, by number."""
    return {number: one.outline for number, one in enumerate(mission.obstacles) if one.outline is not None}


def inside(solid: Floats, places: state.Vectors) -> NDArray[np.bool_]:
    """Mask (N,) of the places (N, d) that are in a solid, (3,) or (5,), or on its edge. Columns have a flat top."""
    gaps = (state.flat(places) - solid[:2]).T
    if places.shape[-1] == state.SPACE:
        lowest, highest = solid[3:]
        if lowest < highest:
            return (np.hypot(*gaps) <= solid[2]) & (places[:, 2] <= highest)
        gaps = np.stack([np.hypot(*gaps), places[:, 2] - highest])
    within: NDArray[np.bool_] = np.hypot(*gaps) <= solid[2]
    return within


def landings(mission: Mission) -> state.Vectors:
    """Landing places of UAVs with a low battery, (L, d) in m."""
    places: state.Vectors = mission.space.vectors(mission.energy.landings, mission.start.height)
    return places


def stations(mission: Mission) -> Floats:
    """Places of the stations, (B, 3) in m."""
    return np.array([station.place for station in mission.stations], dtype=np.float64).reshape(-1, 3)
