"""Table of the limits of waiting and rejoining."""

from typing import Annotated

from meanflock.swarm.scenario.described import OURS, key
from meanflock.swarm.toml import Table as _Table


class Pace(_Table, frozen=True):
    """Limits of the time that all others wait for one node (wall clock, in lockstep), and of rejoins."""

    slow_s: Annotated[
        float,
        key(
            "a reply is slow if it takes longer than this, and longer than `slow_factor` allows",
            OURS,
            "far above what a healthy node takes",
            unit="s",
            gt=0,
        ),
    ] = 2.0
    slow_factor: Annotated[
        float,
        key(
            "a reply is slow if it takes longer than this many times the median of all nodes",
            OURS,
            "if all nodes are slow, no node is to blame",
            ge=1,
        ),
    ] = 10.0
    slow_ticks: Annotated[
        int,
        key(
            "number of slow replies after which a node is lost; one is forgiven every 100 ticks",
            OURS,
            "spares a node that is slow now and then",
            ge=1,
        ),
    ] = 50
    wait_share: Annotated[
        float,
        key(
            "share of the wall time that all others may wait for one agent alone",
            OURS,
            "one agent slows a flight by a quarter at most; an agent may always cost its share of the UAVs",
            later=True,
            gt=0,
            le=1,
        ),
    ] = 0.2
    wait_window_s: Annotated[
        float,
        key(
            "window over which that share is measured; an agent that exceeds it stays out for as long",
            OURS,
            "longer than any pause of a healthy machine",
            unit="s",
            later=True,
            ge=1,
            le=1000000.0,
        ),
    ] = 60.0
    rejoins: Annotated[
        int,
        key(
            "number of rejoins within `rejoin_ticks` after which a node is refused for good",
            OURS,
            "as often as `meanflock run` restarts a process",
            later=True,
            ge=1,
            le=1000,
        ),
    ] = 5
    rejoin_ticks: Annotated[
        int, key("ticks of the window of that limit", OURS, "a minute of flight", unit="ticks", later=True, ge=1)
    ] = 600
