"""One leader averages the uploads of all participants, as the paper has it."""

import numpy as np

from meanflock.federation import coding
from meanflock.federation.topology.base import Hop, Topology
from meanflock.swarm.wire.messages import FrameKind


class LeaderTopology(Topology):
    """Participants upload to the leader's UAV, which broadcasts the average to all."""

    name = "leader"
    bears_clusters = False

    def hops(self) -> tuple[Hop, ...]:
        scenario, leader = self.scenario, self.scenario.federation.leader
        everyone = np.arange(scenario.uavs)
        cut = coding.cut_of_models(scenario, self.declared)
        uploads, broadcasts = (
            coding.of_uploads(scenario, self.declared, cut),
            coding.of_broadcasts(scenario, self.declared, cut),
        )
        after = uploads.ticks - 1 + scenario.deadline_ticks
        ticks = after + broadcasts.ticks - 1 + scenario.hop_ticks
        if uploads.fragments is not None and scenario.period_ticks < ticks:
            raise ValueError(
                f"`federation.period` {scenario.period_ticks} has no room for a round of {ticks} ticks, in which "
                f"models go in {uploads.count} fragments; take at least {ticks}"
            )
        upload = Hop(FrameKind.UPLOAD, 0, "agent", everyone, np.full((scenario.uavs, 1), leader), uploads)
        return upload, Hop(
            FrameKind.GLOBAL,
            after,
            "leader",
            np.array([leader]),
            None,
            broadcasts,
            mail=upload,
            ruled=True,
            is_last=True,
        )
