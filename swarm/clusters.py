"""Clusters of UAVs whose heads average for them: known to all beforehand, so nobody has to be told who heads whom."""

from typing import TYPE_CHECKING

import numpy as np

from meanflock.swarm.rounds import HOPS, delivery_ticks
from meanflock.swarm.wire.control import FLOAT_OF_BITS

if TYPE_CHECKING:
    from meanflock.swarm.scenario import Scenario


class Clusters:
    """Who heads whom in a scenario: K clusters of neighbouring numbers, as equal as can be.

    of: (N,) the cluster ⌊iK/N⌋ of UAV i. sizes: (K,) UAVs in each. heads: (K,) UAVs, ascending: the leader's UAV h in
    its own cluster, the lowest in every other. head_of: (N,) the UAV that heads the cluster of UAV i.
    """

    def __init__(self, scenario: "Scenario") -> None:
        count, leader = scenario.federation.clusters, scenario.federation.leader
        self.of = np.arange(scenario.uavs) * count // scenario.uavs
        self.sizes = np.bincount(self.of, minlength=count)
        self.heads = np.searchsorted(self.of, np.arange(count))
        self.heads[self.of[leader]] = leader
        self.head_of = self.heads[self.of]


def check(scenario: "Scenario") -> None:
    """Lets a scenario through whose clusters can do what the rest of it asks.

    Raises:
        ValueError: they cannot; the message says what to change.
    """
    federation, count = scenario.federation, scenario.federation.clusters
    if count == 1:
        return
    asked = f"`federation.clusters` is {count}, but"
    if count > scenario.uavs:
        raise ValueError(f"{asked} `uavs` is {scenario.uavs}; a cluster holds at least one")
    if not scenario.declared.is_federated:
        raise ValueError(
            f"{asked} `method` {scenario.method} has no rounds; take one that shares a model, as mfgfl-hf does"
        )
    if federation.aggregation != "fedavg":
        raise ValueError(
            f"{asked} `federation.aggregation` {federation.aggregation} must see every upload, and heads send "
            "means; take fedavg, or one cluster"
        )
    horizon = int(delivery_ticks(scenario, np.array(scenario.radio.latency_threshold_slots)))
    if scenario.period_ticks <= HOPS * horizon:
        raise ValueError(
            f"{asked} `federation.period` {scenario.period_ticks} has no room for two hops of up to {horizon} ticks; "
            f"take at least {HOPS * horizon + 1}"
        )
    exact = 2 ** (np.finfo(FLOAT_OF_BITS[scenario.radio.bits_per_float]).nmant + 1)
    if (largest := -(-scenario.uavs // count)) > exact:
        raise ValueError(
            f"{asked} a cluster of {largest} UAVs is more than a {scenario.radio.bits_per_float}-bit float counts "
            f"exactly, {exact}; take more clusters or wider floats"
        )
