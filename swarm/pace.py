"""How long nodes may keep a flight waiting: a table of the scenario."""

from typing import Annotated

from msgspec import Meta

from meanflock.swarm.table import Table


class Pace(Table, frozen=True):
    """Which replies are slow, and how many of one node a flight in lockstep takes; in seconds of the wall clock."""

    slow_s: Annotated[float, Meta(gt=0, description="a reply is slow if it takes longer than this and …, s")] = 2.0
    slow_factor: Annotated[
        float, Meta(ge=1, description="… longer than this many times what half of the nodes took")
    ] = 10.0
    slow_ticks: Annotated[
        int, Meta(ge=1, description="slow replies after which a node is lost; one in 100 ticks is forgiven")
    ] = 50
