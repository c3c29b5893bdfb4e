"""The instants of a flight, as every format of an export needs them."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from meanflock.groundstation.results.flown import Flown, Piece
from meanflock.groundstation.results.series import per_uav, states_of
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.wire.messages import Status

MAP = "map"  # the frame of all positions: goal at the origin, x and y as in the scenario, z up
NANOSECONDS = 1_000_000_000


class Instant(NamedTuple):
    """A tick.

    time_ns: since take-off. row: in the table of its piece. states: [x, y, vx, vy] of each UAV. headings: the
    quaternion [z, w] of each velocity, about the vertical axis. events: since the tick before.
    """

    time_ns: int
    row: int
    states: list[list[float]]
    headings: list[list[float]]
    status: list[int]
    events: list[FlightEvent]


def instants(piece: Piece) -> Iterator[Instant]:
    """The ticks of a piece; the last one has all events that are left."""
    states = states_of(piece.rows)
    half = np.arctan2(states[..., 3], states[..., 2]) / 2
    headings = np.stack([np.sin(half), np.cos(half)], axis=-1)
    status = per_uav(piece.rows, "status")[..., 0]
    times = np.rint(piece.rows["sim_time_s"].to_numpy() * NANOSECONDS).astype(np.int64).tolist()
    ticks = piece.rows["tick"].to_pylist()
    events = piece.events
    for row, tick in enumerate(ticks):
        now = [event for event in events if event.tick <= tick] if row + 1 < len(ticks) else events
        events = events[len(now) :]
        yield Instant(times[row], row, states[row].tolist(), headings[row].tolist(), status[row].tolist(), now)


def name(uav: int) -> str:
    """The name of a UAV, and of the frame that moves with it."""
    return f"uav_{uav}"


def label(uav: int, status: int) -> str:
    """The label of a UAV: its number, and its status when it does not fly."""
    return str(uav) if status == Status.FLYING else f"{uav} {Status(status).name.lower()}"


def about(flown: Flown, finished: bool) -> dict[str, str]:
    """The scenario in a few words."""
    return {
        "method": flown.method,
        "uavs": str(flown.uavs),
        "seed": str(flown.seed),
        "finished": str(finished).lower(),
    }
