"""Recorded movement: UAVs that move as a file says, with the power of a point mass."""

import functools
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from meanflock.swarm import mission, paths, state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.vehicles import tracks
from meanflock.worldsim.vehicles.base import Hidden, Vehicle
from meanflock.worldsim.vehicles.point_mass import PointMass

_FILES = 4  # whose tracks are kept for the next flight
_MAY_BE_SET = ("positions", "centre", "height")  # of `[start]`


class RecordedTrace(PointMass):
    """A UAV that moves as a file of places over time says. Commands, gusts, wind and noise have no effect.

    The velocity at the end of a tick is the displacement in that tick over its length. Power is that of the point mass
    at this velocity.
    """

    name = "trace"
    obeys = False

    class Options(Vehicle.Options, frozen=True):
        """Keys of `[vehicle.options]`."""

        file: Annotated[
            str, Meta(description="Parquet or CSV file with columns t_s, uav, x_m, y_m, in space also z_m")
        ] = ""
        sha256: Annotated[str, Meta(description="SHA-256 of the file, 64 hexadecimal digits; filled in if unset")] = ""
        begin_s: (
            Annotated[float, Meta(description="t_s at which the flight begins; unset: that of the earliest row, s")]
            | None
        ) = None
        gap_s: (
            Annotated[float, Meta(gt=0, description="longest time between two rows of a UAV; unset: any, s")] | None
        ) = None
        speed_max_m_s: (
            Annotated[
                float,
                Meta(gt=0, description="largest speed between two rows; unset: `radio.plausible_speed`, m/s"),
            ]
            | None
        ) = None

    options: Options

    def __init__(self, options: Options, scenario: Scenario) -> None:
        """
        Raises:
            BadInput: the file cannot be read or has another hash, its rows are no tracks of these UAVs, or `[start]`
                contradicts it.
        """
        super().__init__(options, scenario)
        _check_start(scenario)
        self._tracks, _ = _opened(options, scenario)
        starts = state.position(mission.starts(scenario))
        if not np.array_equal(_begin(self._tracks, scenario), starts):
            raise BadInput(f"trace {options.file}: the UAVs start elsewhere; leave out `start.positions`")

    @classmethod
    def resolve(cls, options: Options, scenario: Scenario) -> Scenario:  # type: ignore[override]
        """The scenario with the places at which the trace begins."""
        if scenario.start.positions:
            raise BadInput(f"trace {options.file}: the UAVs start where it begins; leave out `start.positions`")
        _check_start(scenario)
        found, sha256 = _opened(options, scenario)
        recorded = scenario.vehicle.options | {"sha256": sha256}
        return scenario.replace(**{"start.positions": _begin(found, scenario).tolist(), "vehicle.options": recorded})

    def init(self, uavs: int) -> Hidden:
        """The number of each UAV, and the ticks that it has flown."""
        return {"uav": np.arange(uavs), "tick": np.zeros(uavs, dtype=np.int64)}

    def rest(self, hidden: Hidden) -> Hidden:
        """The tick after, so that a UAV that is put back does not fall behind."""
        return {"uav": hidden["uav"], "tick": hidden["tick"] + 1}

    def step(
        self, states: state.States, hidden: Hidden, acceleration: state.Vectors, noise: state.Vectors
    ) -> tuple[state.States, Hidden]:
        """The places of the trace a tick later."""
        uavs, ticks = hidden["uav"], hidden["tick"]
        dt = self.scenario.dt
        before, after = self._tracks.at(uavs, dt * ticks), self._tracks.at(uavs, dt * (ticks + 1))
        velocity = (after - before) / dt
        return np.concatenate([after, velocity], axis=1), {"uav": uavs, "tick": ticks + 1}


def _begin(found: tracks.Tracks, scenario: Scenario) -> state.Vectors:
    """Places (N, d) of all UAVs where the flight begins."""
    return found.at(np.arange(scenario.uavs), np.zeros(scenario.uavs))


def _check_start(scenario: Scenario) -> None:
    """Check that `[start]` has no key that the trace decides."""
    start, default = scenario.start, type(scenario.start)()
    for name in start.__struct_fields__:
        if name not in _MAY_BE_SET and getattr(start, name) != getattr(default, name):
            raise BadInput(
                f"vehicle {RecordedTrace.name!r}: `start.{name}` has no effect, because the UAVs start where the "
                "trace begins; leave it out"
            )


def _opened(options: RecordedTrace.Options, scenario: Scenario) -> tuple[tracks.Tracks, str]:
    """The tracks of the file since the flight begins, and the SHA-256 of the file."""
    if not options.file:
        raise BadInput(f"vehicle {RecordedTrace.name!r}: it needs a file; set `vehicle.options.file`")
    path = paths.given(options.file)
    bounds = tracks.StepBounds(options.speed_max_m_s or scenario.radio.plausible_speed, options.gap_s)
    found, sha256 = _read(path, tracks.stamp(path), scenario.dimensions, scenario.uavs, bounds, options.begin_s)
    if options.sha256 not in ("", sha256):
        raise BadInput(
            f"trace {path} has the SHA-256 {sha256}, and the scenario wants {options.sha256}; bring that file back, or "
            "leave out `vehicle.options.sha256` and `start.positions` to fly this one"
        )
    return found, sha256


@functools.lru_cache(maxsize=_FILES)
def _read(
    path: Path,
    stamp: tuple[int, ...],
    axes: int,
    uavs: int,
    bounds: tracks.StepBounds,
    begin_s: float | None,
) -> tuple[tracks.Tracks, str]:
    """The tracks of a file, and its SHA-256. `stamp` tells a file that was changed since it was read."""
    table, sha256 = tracks.read(path, axes)
    try:
        tracks.check(table, uavs, bounds)
    except ValueError as error:
        raise BadInput(f"trace {path}: {error}") from error
    first, last = float(table.times.min()), float(table.times.max())
    begin_s = first if begin_s is None else begin_s
    if not first <= begin_s <= last:
        raise BadInput(
            f"trace {path}: `vehicle.options.begin_s` is {begin_s:g} s, and it lasts from {first:g} to {last:g} s; "
            "take a time within"
        )
    return tracks.Tracks(table, begin_s), sha256
