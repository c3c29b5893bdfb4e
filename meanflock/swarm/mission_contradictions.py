"""Contradictions in a mission: places that contradict each other, the ground, or the limits of altitude."""

import itertools
from typing import Any

import numpy as np

from meanflock.swarm import state
from meanflock.swarm.mission import (
    GRIDS,
    FlownMission,
    Mission,
    formation,
    goals,
    has_starts,
    inside,
    launches,
    polygons,
    recorded_starts,
    solids,
    starts,
)


def check(mission: FlownMission) -> None:
    """Raises ValueError if parts of the mission contradict each other, or if a start or goal is inside an obstacle."""
    _check_tables(mission)
    if not has_starts(mission):
        return
    each, outlines = solids(mission), polygons(mission)
    is_space = mission.space.dimensions == state.SPACE
    if is_space or len(each):
        remedy = "move one of them"
        for verb, places in (("starts", state.position(starts(mission))), ("has its goal", goals(mission))):
            if is_space and (lowest := places[:, -1].min()) < 0.0:
                raise ValueError(
                    f"UAV {places[:, -1].argmin()} {verb} {-lowest:g} m below the ground, z = 0; raise its place, "
                    "`start.centre`, or `start.height` where these have two numbers"
                )
            _check_altitudes(mission, verb, places)
            for number, solid in enumerate(each):
                outline = outlines.get(number)
                within = np.flatnonzero(inside(solid, places) if outline is None else outline.holds(places))
                if len(within):
                    raise ValueError(f"UAV {within[0]} {verb} inside `obstacles[{number}]`; {remedy}")
    has_own = any(group.start is not None for group in mission.groups)
    if not recorded_starts(mission) and (has_own or mission.start.positions or formation(mission.start) not in GRIDS):
        _check_apart(mission)


def _check_altitudes(mission: Mission, verb: str, places: state.Vectors) -> None:
    """Raises ValueError if one of `places` (N, d) is beyond the floor or the ceiling."""
    for side, limit in mission.space.limits:
        beyond = side * (limit - places[:, -1])
        if (worst := float(beyond.max())) > 0.0:
            where = "below `space.floor`" if side > 0.0 else "above `space.ceiling`"
            raise ValueError(
                f"UAV {beyond.argmax()} {verb} {worst:g} m {where} {limit:g} m; move the limit, its place, "
                "`start.centre`, or `start.height` where these have two numbers"
            )


def _check_tables(mission: Mission) -> None:
    floor, ceiling = mission.space.floor, mission.space.ceiling
    if floor is not None and ceiling is not None and floor >= ceiling:
        raise ValueError(f"`space.floor` {floor:g} m is not below `space.ceiling` {ceiling:g} m; lower it")
    is_space = mission.space.dimensions == state.SPACE
    _check_start(mission.start, mission.uavs, is_space)
    _check_goals(mission.destination, mission.start, mission.uavs, is_space)
    for number, group in enumerate(mission.groups):
        try:
            if group.start is not None:
                _check_start(group.start, group.count, is_space)
            if group.destination is not None:
                _check_goals(group.destination, group.start or mission.start, group.count, is_space)
        except ValueError as error:
            raise ValueError(f"`groups[{number}]`: {error}") from None


def _check_start(start: Any, uavs: int, is_space: bool) -> None:
    """Raises ValueError if a `[start]` of so many UAVs contradicts itself."""
    _check_positions("start", start, "formation", uavs)
    if formation(start) == "sphere" and not is_space:
        raise ValueError('`start.formation` "sphere" needs space; set `space.dimensions` to 3, or take circle')
    if start.layers > 1:
        if not is_space:
            raise ValueError("`start.layers` has no effect in the plane; set `space.dimensions` to 3, or leave it out")
        if start.positions or formation(start) not in (*GRIDS, "streams"):
            raise ValueError("`start.layers` has no effect here; leave it out, or take grid, waves or streams")
        if start.layers > uavs:
            raise ValueError(f"`start.layers` is {start.layers}, but `uavs` is {uavs}; take {uavs} layers at most")


def _check_goals(destination: Any, start: Any, uavs: int, is_space: bool) -> None:
    """Raises ValueError if a `[destination]` of so many UAVs contradicts itself, or their `[start]`."""
    _check_positions("destination", destination, "goals", uavs)
    _check_waypoints(destination, is_space)
    if destination.goals == "vertical" and not is_space:
        raise ValueError('`destination.goals` "vertical" needs space; set `space.dimensions` to 3, or take other goals')
    if destination.goals == "across" and formation(start) != "streams":
        raise ValueError('`destination.goals` "across" needs streams; set `start.formation` to streams, or other goals')


def _check_waypoints(destination: Any, is_space: bool) -> None:
    """Raises ValueError if the waypoints of a `[destination]` contradict its other keys."""
    points, times = destination.waypoints, destination.times_s
    if not points:
        for key, is_set in (("times_s", bool(times)), ("patrol", destination.patrol)):
            if is_set:
                raise ValueError(f"`destination.{key}` has no effect without `destination.waypoints`; set that too")
        return
    for key in ("goals", "positions"):
        if getattr(destination, key):
            raise ValueError(f"`destination.waypoints` and `destination.{key}` are both given; leave one of them out")
    if not is_space and any(len(point) > state.PLANE for point in points):
        raise ValueError(
            "`destination.waypoints` has three numbers, and the flight is in the plane; set `space.dimensions` to 3, "
            "or leave the third out"
        )
    if destination.patrol and len(points) < 2:
        raise ValueError("`destination.patrol` needs two `destination.waypoints` or more; add one, or leave it out")
    if times and (len(times) != len(points) or times[0] != 0.0 or any(b <= a for a, b in itertools.pairwise(times))):
        raise ValueError(
            f"`destination.times_s` {list(times)} must ascend from 0, one for each of the {len(points)} waypoints"
        )


def _check_positions(name: str, table: Any, other: str, uavs: int) -> None:
    """Raises ValueError if the places in a table are not one for each UAV, or the key that they replace is set."""
    if table.positions and getattr(table, other) is not None:
        raise ValueError(f"`{name}.positions` and `{name}.{other}` are both given; leave one of them out")
    if table.positions and len(table.positions) != uavs:
        raise ValueError(f"`{name}.positions` has {len(table.positions)} places for {uavs} UAVs; list one for each")


def _check_apart(mission: Mission) -> None:
    """Raises ValueError if two UAVs that leave at the same time start within the collision radius.

    Grids are not checked: their spacing is a key of its own, and their collisions are counted. So are those of recorded
    UAVs, which may stand at one place before they leave.
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
            apart = float(state.length(places[first] - places[second]))
            raise ValueError(
                f"UAV {first} and UAV {second} start {apart:g} m apart, nearer than `metrics.collision_radius` "
                f"{least:g} m; move them apart, or take fewer UAVs"
            )
