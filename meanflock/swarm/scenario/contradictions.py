"""Contradictions between the keys of a `Scenario` (which this module cannot import), refused when it is made."""

import os
from typing import Any

import numpy as np

from meanflock.swarm import mission, mission_contradictions, state
from meanflock.swarm.scenario import tables
from meanflock.swarm.scenario.until import Until
from meanflock.swarm.wire.control import FLOAT_OF_BITS

_MOST_WITH_DOWNWASH = 2000  # UAVs: their wakes take a fifth of a second and 120 MB in each tick
_LEAST_FROM_STATION_M = 1.0  # between a station and a UAV at its start
_LEAST_BYTES = 1000  # of a UAV: states, links and commands, without a controller


def check(scenario: Any) -> None:
    """Raises ValueError where keys of a scenario contradict each other, or the machine; the text names the keys."""
    _check_memory(scenario)
    _check_groups(scenario)
    if scenario.federation.leader >= scenario.uavs:
        raise ValueError(
            f"`federation.leader` is {scenario.federation.leader}, but the UAVs are 0…{scenario.uavs - 1}; name one of "
            "them"
        )
    _check_stations(scenario)
    _check_radios(scenario)
    _check_batteries(scenario)
    if scenario.until is not None:
        Until.of_text(scenario.until)
    if scenario.duration < scenario.dt:
        raise ValueError(f"`duration` {scenario.duration} s is shorter than one tick, `dt` {scenario.dt} s")
    for name, drag in (("wind.drag", scenario.wind.drag), ("truth.drag", scenario.truth.drag)):
        if drag is not None and scenario.dt * drag >= 2:
            raise ValueError(f"`dt` {scenario.dt} s is unstable with `{name}` {drag} 1/s; keep dt·drag < 2")
    longest = scenario.radio.latency_threshold_slots * scenario.radio.coherence_time_s
    has_own_bands = scenario.radio.access == "fdma"  # in one band uploads wait, and the plan says how long
    if has_own_bands and (deadline := scenario.federation.deadline) is not None and deadline > longest * (1 + 1e-9):
        raise ValueError(
            f"`federation.deadline` {deadline} s is later than an upload can arrive, {longest:g} s: "
            "`radio.latency_threshold_slots` times `radio.coherence_time_s`; take less, or leave it out"
        )
    if scenario.radio.bands == "cluster" and scenario.radio.access != "tdma":
        raise ValueError(
            f"`radio.bands` is cluster, but `radio.access` is {scenario.radio.access}; take tdma, or `radio.bands` one"
        )
    if scenario.radio.access != "csma" and scenario.radio.contention_slot_s != tables.Radio().contention_slot_s:
        raise ValueError(
            f"`radio.contention_slot_s` has no effect, because `radio.access` is {scenario.radio.access}; set "
            "radio.access=csma, or leave it out"
        )
    if scenario.radio.access == "csma" and scenario.radio.contention_slots > 0.5 * (1 + 1e-9):
        raise ValueError(
            f"`radio.contention_slot_s` {scenario.radio.contention_slot_s:g} s is more than half of "
            f"`radio.coherence_time_s` {scenario.radio.coherence_time_s:g} s; take less, or longer slots"
        )
    _check_plane(scenario)
    if scenario.wind.downwash != "none" and scenario.uavs > _MOST_WITH_DOWNWASH:
        raise ValueError(
            f"`wind.downwash` compares all pairs of UAVs, and `uavs` is {scenario.uavs}; take {_MOST_WITH_DOWNWASH} at "
            "most, or leave it out"
        )
    for number, one in enumerate(scenario.obstacles):
        if one.height is not None and len(one.centre) > state.PLANE:
            raise ValueError(
                f"`obstacles[{number}]` is a sphere, because its `centre` has three numbers, and has no `height`; "
                "leave out the height or the third number"
            )
    mission_contradictions.check(scenario)
    widest = float(np.finfo(FLOAT_OF_BITS[scenario.radio.bits_per_float]).max)
    if mission.has_starts(scenario) and (farthest := float(np.abs(mission.starts(scenario)).max())) > widest:
        raise ValueError(
            f"`start` places a UAV {farthest:g} m out, and a float of the radio, `radio.bits_per_float` "
            f"{scenario.radio.bits_per_float}, holds {widest:g} at most; start nearer, or take a wider float"
        )
    for number, fault in enumerate(scenario.faults):
        if any(uav >= scenario.uavs for uav in getattr(fault, "uavs", ())):
            raise ValueError(
                f"`faults[{number}].uavs` names UAV {max(fault.uavs)} of 0…{scenario.uavs - 1}; name one of them"
            )
        for station in getattr(fault, "stations", ()):
            if station >= len(scenario.stations):
                raise ValueError(
                    f"`faults[{number}].stations` names station {station}, and there are {len(scenario.stations)} "
                    "`[[stations]]`, numbered from 0"
                )


def _check_groups(scenario: Any) -> None:
    """Raises ValueError where `[[groups]]` do not have all UAVs, share a name, or join after the end."""
    if not scenario.groups:
        if scenario.federation.group is not None:
            raise ValueError("`federation.group` is set, and there are no `[[groups]]`; add them, or leave it out")
        return
    names = [group.name for group in scenario.groups]
    if (total := sum(group.count for group in scenario.groups)) != scenario.uavs:
        most = tables.MOST_UAVS
        remedy = f"set `uavs` to {total}" if total <= most else f"lower a `count`, because `uavs` is {most} at most"
        raise ValueError(f"`groups` have {total} UAVs in all, and `uavs` is {scenario.uavs}; {remedy}")
    if twice := [name for name in names if names.count(name) > 1]:
        raise ValueError(f"two `groups` have the name {twice[0]!r}; give each a name of its own")
    if scenario.federation.group == ():
        raise ValueError("`federation.group` is an empty list; name the groups that take part, or leave it out")
    for name in scenario.federation.groups:
        if scenario.federation.groups.count(name) > 1:
            raise ValueError(f"`federation.group` names {name!r} twice; name each group once")
        if name not in names:
            raise ValueError(
                f"`federation.group` names {name!r}, and the groups are {', '.join(names)}; name one of these"
            )
    for number, group in enumerate(scenario.groups):
        joins, leaves = group.joins_in(scenario.dt), group.leaves_in(scenario.dt)
        if leaves is not None and leaves <= joins:
            raise ValueError(
                f"group {group.name!r} leaves at {group.leaves_at_s:g} s, and joins at {group.joins_at_s:g} s; let it "
                f"leave at least a tick, `dt` {scenario.dt:g} s, later, or leave `leaves_at_s` out"
            )
        if joins >= scenario.max_ticks:
            raise ValueError(
                f"`groups[{number}].joins_at_s` is {group.joins_at_s:g} s, and the flight ends at `duration`, "
                f"{scenario.duration:g} s; let it join earlier, or fly longer"
            )
        if (
            group.start is not None
            and scenario.dimensions == state.PLANE
            and group.start.height != scenario.start.height
        ):
            raise ValueError(
                f"`groups[{number}].start.height` is {group.start.height:g} m, and in the plane all fly at "
                f"`start.height`, {scenario.start.height:g} m; make them equal, or set `space.dimensions` to 3"
            )


def _check_batteries(scenario: Any) -> None:
    """Raises ValueError where a reserve cannot carry a UAV from a goal to a landing place, or keys of batteries
    have no effect."""
    energy, default = scenario.energy, tables.Energy()
    if energy.battery_J is None:
        for name in ("reserve", "landings", "empty"):
            if getattr(energy, name) != getattr(default, name):
                raise ValueError(f"`energy.{name}` has no effect without `energy.battery_J`; set that too")
        return
    if scenario.dimensions == state.PLANE and any(len(place) > state.PLANE for place in energy.landings):
        raise ValueError("`energy.landings` has three numbers, and the flight is in the plane; leave the third out")
    if not mission.has_starts(scenario):
        return
    ways, left = mission.farthest_from_landing(scenario), energy.reserve * energy.battery_J
    speeds = np.linspace(0.5, 50.0, 100)
    for vehicle, rows in mission.vehicles(scenario):
        if vehicle.model != tables.VehicleTable().model:
            continue  # another vehicle has a power of its own
        least = float((vehicle.power(speeds * speeds, speeds) / speeds).min())  # J/m
        farthest = float(ways[rows].max())
        if left < least * farthest:
            raise ValueError(
                f"`energy.battery_J` {energy.battery_J:g} J leaves a reserve of {left:g} J, and {farthest:.4g} m from "
                f"a goal to the nearest landing place take {least * farthest:.4g} J at least; take a larger battery or "
                "reserve, or add a place to `energy.landings`"
            )


def _check_memory(scenario: Any) -> None:
    """Raises ValueError where the memory of this machine could not even hold the states of the UAVs.

    What a whole flight needs is checked before it starts.
    """
    least, most = _LEAST_BYTES * scenario.uavs, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if least > most:
        raise ValueError(
            f"`uavs` is {scenario.uavs}, which needs {least / 2**30:,.0f} GiB at least, and this machine has "
            f"{most / 2**30:,.0f} GiB; take fewer"
        )


def _check_plane(scenario: Any) -> None:
    """Raises ValueError where a flight in the plane has a vector of three numbers, or a key of space."""
    if scenario.dimensions != state.PLANE:
        return
    of_space = {
        "space.floor": scenario.space.floor is not None,
        "space.ceiling": scenario.space.ceiling is not None,
        "wind.profile_exponent": scenario.wind.profile_exponent > 0.0,
        "wind.downwash": scenario.wind.downwash != "none",
        **{f"obstacles[{number}].height": one.height is not None for number, one in enumerate(scenario.obstacles)},
    }
    for name, is_set in of_space.items():
        if is_set:
            raise ValueError(f"`{name}` has no effect in the plane; set `space.dimensions` to 3, or leave it out")
    vectors = {
        "start.positions": scenario.start.positions,
        "start.centre": (scenario.start.centre,),
        "destination.positions": scenario.destination.positions,
        "wind.mean": (scenario.wind.mean,),
        "truth.wind": (scenario.truth.wind or (),),
    }
    vectors |= {f"obstacles[{number}].centre": (one.centre,) for number, one in enumerate(scenario.obstacles)}
    for number, fault in enumerate(scenario.faults):
        vectors[f"faults[{number}].acceleration"] = (getattr(fault, "acceleration", ()),)
    for name, given in vectors.items():
        if any(len(vector) > state.PLANE for vector in given):
            raise ValueError(
                f"`{name}` has three numbers, and the flight is in the plane; set `space.dimensions` to 3, or "
                "leave the third out"
            )


def _check_stations(scenario: Any) -> None:
    """Raises ValueError where a station is named that is not there, or stands where a UAV starts."""
    if (station := scenario.federation.station) is not None and station >= len(scenario.stations):
        raise ValueError(
            f"`federation.station` is {station}, and there are {len(scenario.stations)} `[[stations]]`, numbered from "
            f"0; {'name one of them' if scenario.stations else 'add one'}, or leave the key out"
        )
    if not mission.has_starts(scenario):
        return
    starts = mission.in_space(scenario, state.position(mission.starts(scenario)))
    for number, one in enumerate(scenario.stations):
        apart = state.length(starts - np.array(one.place))
        if (near := float(apart.min())) < _LEAST_FROM_STATION_M:
            raise ValueError(
                f"`stations[{number}]` stands {near:.2g} m from the start of UAV {apart.argmin()}, at a height of "
                f"{starts[apart.argmin(), -1]:g} m; move it {_LEAST_FROM_STATION_M:g} m away or more"
            )


def _check_radios(scenario: Any) -> None:
    """Raises ValueError where `[[radios]]` names a UAV twice, or one that is not there."""
    named: set[int] = set()
    for number, radio in enumerate(scenario.radios):
        if radio.group is not None and radio.group not in (group.name for group in scenario.groups):
            raise ValueError(f"`radios[{number}].group` names {radio.group!r}, which is none of `groups`; add it")
        for uav in mission.uavs_of(scenario, radio):
            if uav >= scenario.uavs:
                raise ValueError(f"`radios[{number}].uavs` names UAV {uav} of 0…{scenario.uavs - 1}; name one of them")
            if uav in named:
                raise ValueError(f"`radios[{number}].uavs` names UAV {uav}, which has a radio already; name it once")
            named.add(uav)
