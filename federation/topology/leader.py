"""One leader averages the uploads of all participants, as the paper has it."""

import numpy as np

from meanflock.federation import coding
from meanflock.federation.topology.base import Hop, Topology
from meanflock.swarm.wire.messages import FrameKind


class Leader(Topology):
    """Participants upload to the leader's UAV, which broadcasts the average to all."""

    name = "leader"

    def hops(self) -> tuple[Hop, ...]:
        scenario, leader = self.scenario, self.scenario.federation.leader
        everyone = np.arange(scenario.uavs)
        upload = Hop(
            FrameKind.UPLOAD, 0, "agent", everyone, np.full((scenario.uavs, 1), leader), coding.of_uploads(scenario)
        )
        return upload, Hop(
            FrameKind.GLOBAL,
            scenario.deadline_ticks,
            "leader",
            np.array([leader]),
            None,
            coding.of_broadcasts(scenario),
            mail=upload,
            ruled=True,
            is_last=True,
        )
