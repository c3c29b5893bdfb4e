"""The fault script of a scenario: kinds of faults, each with its UAVs or area, begin and duration.

Every fault acts on the model, not on a process: the world applies it in a given tick, so the same script flies the
same trajectory in one process and on many. All times are simulated time.
"""

from collections.abc import Iterable
from typing import Annotated, TypeAlias

from msgspec import Meta

from meanflock.swarm.toml import Point, Table

Uavs: TypeAlias = Annotated[tuple[Annotated[int, Meta(ge=0)], ...], Meta(description="the UAVs that it hits")]
Stations: TypeAlias = Annotated[
    tuple[Annotated[int, Meta(ge=0)], ...], Meta(description="the stations that it hits, numbered from 0")
]
Duration: TypeAlias = Annotated[float, Meta(gt=0, description="duration of the fault, s")]


class _Fault(Table, frozen=True, tag_field="kind", omit_defaults=True):
    """Base class of faults. A fault begins in a tick, which is given as a number or as simulated seconds."""

    tick: Annotated[int, Meta(ge=0, description="tick in which it begins")] | None = None
    time_s: Annotated[float, Meta(ge=0, description="or the time at which it begins, s")] | None = None
    harmless: Annotated[
        bool, Meta(description="declares that the fault changes neither trajectory nor link statistics")
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.tick is None) == (self.time_s is None):
            raise ValueError("a fault begins at a `tick` or at a `time_s`: give one of them")

    def begins(self, dt: float) -> int:
        """First tick in which the fault acts."""
        return self.tick if self.tick is not None else round((self.time_s or 0.0) / dt)

    def ends(self, dt: float) -> int:
        """First tick after the fault; a fault without duration acts in one tick."""
        duration = getattr(self, "duration_s", None)
        return self.begins(dt) + (1 if duration is None else max(1, round(duration / dt)))

    def acts(self, tick: int, dt: float) -> bool:
        """Returns whether the fault acts in a tick."""
        return self.begins(dt) <= tick < self.ends(dt)


class _OfSome(_Fault, frozen=True, kw_only=True):
    """A fault of named UAVs and stations."""

    uavs: Uavs = ()
    stations: Stations = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.uavs and not self.stations:
            raise ValueError("a fault hits `uavs` or `stations`: name one at least")


class _Where(_Fault, frozen=True, kw_only=True):
    """A fault of an area, or of named UAVs."""

    duration_s: Duration
    uavs: Uavs = ()
    centre: Annotated[tuple[float, float], Meta(description="centre of the area, m")] | None = None
    radius_m: Annotated[float, Meta(gt=0, description="radius of the area, m")] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.centre is None) != (self.radius_m is None):
            raise ValueError("an area needs both `centre` and `radius_m`")


class Kill(_OfSome, frozen=True, kw_only=True, tag="kill"):
    """UAVs and stations are lost for good, without commands and radio. A node gets Stop when all its UAVs are lost."""


class Pause(_OfSome, frozen=True, kw_only=True, tag="pause"):
    """UAVs keep their last command, and neither receive, send nor learn, like a stopped computer; stations average
    nothing."""

    duration_s: Duration


class Partition(_OfSome, frozen=True, kw_only=True, tag="partition"):
    """Every radio link from or to these UAVs and stations fails, links between them included; the slots are spent."""

    duration_s: Duration


class Jam(_Where, frozen=True, kw_only=True, tag="jam"):
    """Links between two of the named UAVs and stations, or with an end in the area, fail; the slots are spent."""

    stations: Stations = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if (len(self.uavs) + len(self.stations) < 2) == (self.centre is None):
            raise ValueError(
                "a jam needs either two or more `uavs` and `stations`, or an area of `centre` and `radius_m`"
            )


class Interference(_Fault, frozen=True, kw_only=True, tag="noise"):
    """A jammer sends noise, which adds to that of every receiver, as far as it is in sight over free space."""

    duration_s: Duration
    place: Annotated[tuple[float, float, float], Meta(description="where its antenna is, height last, m")]
    power_dbm: Annotated[float, Meta(ge=-300, le=300, description="its power, dBm")]
    bandwidth_hz: Annotated[float, Meta(ge=1, le=1e15, description="the band over which it is spread, Hz")]


class Gust(_Where, frozen=True, kw_only=True, tag="gust"):
    """Wind that accelerates the named UAVs, those in the area, or all."""

    acceleration: Annotated[Point, Meta(description="acceleration of every UAV that it hits, m/s²")]


class LeaderLoss(_Fault, frozen=True, kw_only=True, tag="leader-loss"):
    """The leader is lost for good; a standby takes over if there is one."""

    standby: Annotated[bool, Meta(description="whether a standby leader is started")] = True


Fault: TypeAlias = Kill | Pause | Partition | Jam | Interference | Gust | LeaderLoss


def nodes_hit(fault: Kill | Pause | Partition | Jam, uavs: int) -> list[int]:
    """The nodes that a fault names: UAVs, then stations, which are the nodes from `uavs`, N, on."""
    return [*fault.uavs, *(uavs + station for station in fault.stations)]


def kind(fault: Fault) -> str:
    """Name of the kind of a fault in a script."""
    return str(fault.__struct_config__.tag)


def paused(faults: Iterable[Fault], tick: int, dt: float) -> list[int]:
    """UAVs that are paused in a tick, ascending. World and agents compute this themselves, without a message."""
    return sorted({uav for fault in faults if isinstance(fault, Pause) and fault.acts(tick, dt) for uav in fault.uavs})
