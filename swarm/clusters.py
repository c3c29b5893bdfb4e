"""Clusters of UAVs whose heads average for them: known to all beforehand, so nobody has to be told who heads whom."""

import numpy as np

from meanflock.swarm.scenario import Scenario


class Clusters:
    """Who heads whom in a scenario: K clusters of neighbouring numbers, as equal as can be.

    of: (N,) the cluster ⌊iK/N⌋ of UAV i. sizes: (K,) UAVs in each. heads: (K,) UAVs, ascending: the leader's UAV h in
    its own cluster, the lowest in every other. head_of: (N,) the UAV that heads the cluster of UAV i.
    """

    def __init__(self, scenario: Scenario) -> None:
        count, leader = scenario.federation.clusters, scenario.federation.leader
        self.of = np.arange(scenario.uavs) * count // scenario.uavs
        self.sizes = np.bincount(self.of, minlength=count)
        self.heads = np.searchsorted(self.of, np.arange(count))
        self.heads[self.of[leader]] = leader
        self.head_of = self.heads[self.of]
