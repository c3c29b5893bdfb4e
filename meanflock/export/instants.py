"""The instants of a flight, as an export needs them."""

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np

from meanflock.results.flown import FlightSoFar, FlownKeys, Piece
from meanflock.results.quantities import ATTITUDE
from meanflock.results.series import per_uav, states_of
from meanflock.results.stored_run import began
from meanflock.swarm import mission, state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.state import Floats

NANOSECONDS = 1_000_000_000
MOST_UAVS = 2000  # that an instant has; of more UAVs it has so many, evenly chosen by number
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST = datetime(2038, 1, 1, tzinfo=UTC)  # messages of ROS 2 count seconds in 32 bits


class Instant(NamedTuple):
    """A tick.

    time_ns: see `time_ns`. row: in the table of its piece. uavs: the numbers of the UAVs that it has. places,
    velocities: [x, y, z] of each UAV; z is 0 in the plane. turns: the quaternion [x, y, z, w] of each UAV: its
    attitude, of a vehicle that shows one, or the heading of its velocity. events: since the tick before.
    """

    time_ns: int
    row: int
    uavs: list[int]
    places: list[list[float]]
    velocities: list[list[float]]
    turns: list[list[float]]
    status: list[int]
    events: list[FlightEvent]


def time_ns(flight: FlightSoFar, seconds: float) -> int:
    """A simulated time on the clock of an export, ns."""
    return flight.take_off_ns + round(seconds * NANOSECONDS)


def take_off(text: str, folder: Path) -> int:
    """A time of take-off, ns since 1970: a text in ISO 8601 with a time zone, or `run`: when the run in `folder` began.

    Raises:
        BadInput: it is none, before 1970, or after 2037.
    """
    expected = (
        "give a time with a time zone as in 2026-11-21T10:15:00Z, from 1970 to 2037, or `run`: when the run began"
    )
    try:
        at = began(folder) if text == "run" else datetime.fromisoformat(text)
    except ValueError:
        at = None
    if at is None or at.tzinfo is None or not _EPOCH <= at < _LAST:
        raise BadInput(f"--take-off {text}: {expected}")
    return (at - _EPOCH) // timedelta(microseconds=1) * 1000


def instants(flight: FlightSoFar, piece: Piece) -> Iterator[Instant]:
    """The ticks of a piece of a flight; the last one has all events that are left."""
    uavs = flight.scenario.uavs
    shown = np.linspace(0, uavs - 1, min(uavs, MOST_UAVS)).astype(np.intp)
    states = states_of(piece.rows)[:, shown]
    places, velocities = state.in_three(state.position(states)), state.in_three(state.velocity(states))
    yaw = np.arctan2(velocities[..., 1], velocities[..., 0])
    roll = pitch = np.zeros_like(yaw)
    if set(ATTITUDE) <= {*piece.rows.schema.names}:
        attitude = np.moveaxis(per_uav(piece.rows, *ATTITUDE)[:, shown].astype(np.float64), -1, 0)
        roll, pitch, yaw = np.where(np.isnan(attitude), (roll, pitch, yaw), attitude)  # NaN: of another vehicle
    turns = _quaternions(roll, pitch, yaw)
    status = per_uav(piece.rows, "status")[:, shown, 0]
    times = [time_ns(flight, seconds) for seconds in piece.rows["sim_time_s"].to_pylist()]
    ticks = piece.rows["tick"].to_pylist()
    events = piece.events
    for row, tick in enumerate(ticks):
        now = [event for event in events if event.tick <= tick] if row + 1 < len(ticks) else events
        events = events[len(now) :]
        yield Instant(
            times[row],
            row,
            shown.tolist(),
            places[row].tolist(),
            velocities[row].tolist(),
            turns[row].tolist(),
            status[row].tolist(),
            now,
        )


def _quaternions(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """Quaternions [x, y, z, w] of the rotations R_z(yaw) R_y(pitch) R_x(roll)."""
    (sr, sp, sy), (cr, cp, cy) = ([part(angle / 2) for angle in (roll, pitch, yaw)] for part in (np.sin, np.cos))
    x, y = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
    return np.stack([x, y, cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy], axis=-1)


def about(flown: FlownKeys, finished: bool) -> dict[str, str]:
    """The scenario in a few words."""
    return {
        "method": mission.method(flown),
        "uavs": str(flown.uavs),
        "seed": str(flown.seed),
        "finished": str(finished).lower(),
    }
