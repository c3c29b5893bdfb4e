"""Events of a flight, for log, recording and tables: a type for each, with its facts as fields."""

from collections.abc import Mapping
from typing import Any, TypeAlias, get_args

import msgspec

from meanflock.swarm.events.base import BaseEvent, Level, Uavs
from meanflock.swarm.events.mission import (
    Arrived,
    Collided,
    CommandsIgnored,
    Diverged,
    DutyExceeded,
    FaultBegan,
    FaultEnded,
    FaultNeverBegins,
    Grounded,
    HitObstacle,
    Joined,
    Landed,
    LeftAltitudes,
    LinksClamped,
    Lost,
    Rejoined,
    StatesRefused,
    SteeringBegan,
    SteeringEnded,
    TurnedBack,
)
from meanflock.swarm.events.nodes import (
    AgentFailed,
    AverageFailed,
    Dropped,
    FitFailed,
    FlightFailed,
    FlightFinished,
    FlightResumed,
    GlobalDraw,
    LastReturn,
    LeaderFailed,
    LeaderStandsBy,
    LeaderTookOver,
    NoCheckpoint,
    NodeIsSlow,
    NodeLost,
    NodesJoined,
)
from meanflock.swarm.events.rounds import ClusterLeftOut, FragmentsReceived, RoundEnded, UploadsRefused


class Untyped(BaseEvent, frozen=True):
    """An event of a run of meanflock 1.0, of which the file has words only."""

    meanings = {}
    kind: str
    text: str
    uavs: Uavs = ()


FlightEvent: TypeAlias = (
    NodesJoined
    | FlightResumed
    | RoundEnded
    | FragmentsReceived
    | ClusterLeftOut
    | LeaderTookOver
    | LeaderFailed
    | AgentFailed
    | AverageFailed
    | FitFailed
    | UploadsRefused
    | StatesRefused
    | LastReturn
    | Dropped
    | NodeIsSlow
    | Lost
    | NodeLost
    | Diverged
    | Rejoined
    | LeaderStandsBy
    | CommandsIgnored
    | Arrived
    | Landed
    | Joined
    | TurnedBack
    | SteeringBegan
    | SteeringEnded
    | Collided
    | HitObstacle
    | Grounded
    | LeftAltitudes
    | DutyExceeded
    | LinksClamped
    | FaultBegan
    | FaultEnded
    | FaultNeverBegins
    | GlobalDraw
    | NoCheckpoint
    | FlightFailed
    | FlightFinished
    | Untyped
)

TYPES: dict[str, type[BaseEvent]] = {str(each.__struct_config__.tag): each for each in get_args(FlightEvent)}
KINDS = tuple(dict.fromkeys(kind for each in TYPES.values() for kind in each.meanings))
LEVELS: dict[str, Level] = {kind: each.level for each in TYPES.values() for kind in each.meanings}  # by kind


def fields_of(event: FlightEvent) -> dict[str, Any]:
    """All fields of an event, by name, as JSON has them."""
    fields = {name: getattr(event, name) for name in event.__struct_fields__}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()}


def event_of(name: str, fields: Mapping[str, Any]) -> FlightEvent:
    """The event of a type, named as in `TYPES`, with these fields.

    Raises:
        ValueError, TypeError, KeyError: there is no such type, or a field is missing or invalid.
    """
    values = (fields[field] for field in TYPES[name].__struct_fields__)
    event: FlightEvent = msgspec.convert([name, *values], FlightEvent)
    return event
