"""Tables of groups of UAVs, whose controller, learner, vehicle and mission differ from those of the flight."""

from typing import Annotated, Any

from msgspec import Meta

from meanflock.swarm.explain import NAME
from meanflock.swarm.scenario.tables.mission import Destination, Start
from meanflock.swarm.scenario.tables.training import Training
from meanflock.swarm.scenario.tables.vehicle import VehicleTable
from meanflock.swarm.toml import Table as _Table

MOST_UAVS = 2**31 - 1  # of a flight, all groups together
_TIME = Meta(ge=0, le=1000000.0)


class GroupTable(_Table, frozen=True, omit_defaults=True, kw_only=True):
    """UAVs that differ from the others. Groups stand in the order of their UAVs. A key that is unset is as in the
    flight; a table that is set replaces that of the flight as a whole.
    """

    name: Annotated[
        str,
        Meta(pattern=NAME, description="its name, by which columns and other keys call it"),
    ]
    count: Annotated[int, Meta(ge=1, description="number of its UAVs")]
    method: Annotated[str, Meta(description="name of their controller; unset: `method`")] | None = None
    controller: (
        Annotated[
            dict[str, Any],
            Meta(description="options of that controller; unset: `controller`, or none of another method"),
        ]
        | None
    ) = None
    training: Annotated[Training, Meta(description="as `[training]`")] | None = None
    vehicle: Annotated[VehicleTable, Meta(description="as `[vehicle]`")] | None = None
    start: (
        Annotated[
            Start,
            Meta(description="as `[start]`, of this group alone; unset: their places in the formation of the flight"),
        ]
        | None
    ) = None
    destination: Annotated[Destination, Meta(description="as `[destination]`, of this group alone")] | None = None
    joins_at_s: Annotated[
        float, _TIME, Meta(description="time at which they take off; before it they wait, without radio or learning, s")
    ] = 0.0
    leaves_at_s: (
        Annotated[
            float, _TIME, Meta(description="time at which they land where they are, for good; unset: they stay, s")
        ]
        | None
    ) = None

    def joins_in(self, dt: float) -> int:
        """Tick in which they join the flight."""
        return round(self.joins_at_s / dt)

    def leaves_in(self, dt: float) -> int | None:
        """Tick in which they leave the flight; None: they stay."""
        return None if self.leaves_at_s is None else round(self.leaves_at_s / dt)
