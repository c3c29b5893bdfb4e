"""Heads of clusters average for the leader: two levels instead of one."""

import msgspec
import numpy as np

from meanflock.federation.topology.base import Hop, Topology
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.swarm.wire.messages import FrameKind


class Division:
    """The clusters of a scenario: K groups of neighbouring UAV numbers, as equal as can be.

    Attributes:
        cluster: (N,) the cluster ⌊iK/N⌋ of UAV i. sizes: (K,) UAVs in each. heads: (K,) UAVs, ascending: the leader's
        UAV h in its own cluster, unless a station averages; the lowest in every other. head_of: (N,) the UAV that heads
        the cluster of UAV i.
    """

    def __init__(self, scenario: Scenario) -> None:
        count, leader = scenario.federation.clusters, scenario.federation.leader
        self.cluster = np.arange(scenario.uavs) * count // scenario.uavs
        self.sizes = np.bincount(self.cluster, minlength=count)
        self.heads = np.searchsorted(self.cluster, np.arange(count))
        if scenario.federation.station is None:
            self.heads[self.cluster[leader]] = leader
        self.head_of = self.heads[self.cluster]


class Clusters(Topology):
    """Participants upload to the heads of their clusters; the leader averages and broadcasts the heads' means.

    With `radio.bands` = cluster each cluster has a band, and heads and leader have one of their own.
    """

    name = "clusters"
    bears_station = True

    def hops(self) -> tuple[Hop, ...]:
        scenario = self.scenario
        self._check()
        division = Division(scenario)
        everyone, to_heads = np.arange(scenario.uavs), division.head_of[:, None]
        averages = {"codec": self.codecs.relay(division.sizes[division.cluster]), **self.to_seat()}
        has_bands = scenario.radio.bands == "cluster"
        within = division.cluster if has_bands else None
        upload = Hop(FrameKind.UPLOAD, 0, "agent", everyone, to_heads, self.codecs.upload, bands=within)
        relay = Hop(FrameKind.RELAY, self.ticks(upload), "agent", division.heads, averages="models", **averages)
        after = relay.after + self.ticks(relay)
        spread = Hop(FrameKind.GLOBAL, after, "leader", self.seats, None, self.codecs.broadcast, "means")
        least = after + (self.ticks(spread) if self.must_end(spread.codec) else 1)
        if scenario.period_ticks < least:
            raise ValueError(
                f"`federation.clusters` is {scenario.federation.clusters}, but `federation.period` "
                f"{scenario.period_ticks} has no room for two hops of up to {after} ticks in all; take at least {least}"
            )
        above = np.full(scenario.nodes, scenario.federation.clusters) if has_bands else None
        return upload, *(msgspec.structs.replace(hop, bands=above) for hop in (relay, spread))

    def _check(self) -> None:
        """Raises ValueError where clusters cannot do what the rest of the scenario asks."""
        scenario, federation = self.scenario, self.scenario.federation
        count, bits = federation.clusters, scenario.radio.bits_per_float
        asked = f"`federation.clusters` is {count}, but"
        if count > scenario.uavs:
            raise ValueError(f"{asked} `uavs` is {scenario.uavs}; a cluster holds at least one")
        if not self.declared.is_federated:
            raise ValueError(
                f"{asked} `method` {scenario.method} has no rounds; take one that shares a model, as mfgfl-hf does"
            )
        if not getattr(plugins.load("aggregator", federation.aggregation), "bears_means", False):
            raise ValueError(
                f"{asked} `federation.aggregation` {federation.aggregation} must see every upload, and heads send "
                "means; take fedavg, or the topology `leader` without clusters"
            )
        exact = 2 ** (np.finfo(FLOAT_OF_BITS[bits]).nmant + 1)
        if (largest := -(-scenario.uavs // count)) > exact:
            raise ValueError(
                f"{asked} a cluster of {largest} UAVs is more than a {bits}-bit float counts exactly, {exact}; take "
                "more clusters or wider floats"
            )
