"""Every UAV averages what it receives: no leader, one transmission for each upload."""

import numpy as np

from meanflock.federation import coding
from meanflock.federation.topology.base import Hop, Topology
from meanflock.swarm.wire.messages import FrameKind


class Neighbours(Topology):
    """Participants broadcast their models; each UAV averages its own model with those that it received.

    An upload reaches UAVs within `federation.range_m`, else within `radio.range_m`, and is transmitted once.
    """

    name = "neighbours"
    bears_clusters = False

    def hops(self) -> tuple[Hop, ...]:
        scenario = self.scenario
        if not self.declared.is_federated:
            raise ValueError(
                f"`method` {scenario.method} has no rounds; take one that shares a model, as mfgfl-hf does"
            )
        everyone = np.arange(scenario.uavs)
        uploads = coding.of_uploads(scenario, self.declared, coding.cut_of_models(scenario, self.declared))
        ticks = uploads.ticks - 1 + scenario.deadline_ticks
        if scenario.period_ticks <= ticks:
            raise ValueError(
                f"`federation.period` {scenario.period_ticks} has no room for uploads of up to {ticks} ticks; "
                f"take at least {ticks + 1}"
            )
        reach = scenario.federation.range_m or scenario.radio.range_m
        upload = Hop(FrameKind.UPLOAD, 0, "agent", everyone, None, uploads, range_m=reach)
        return upload, Hop(
            FrameKind.GLOBAL,
            ticks,
            "agent",
            everyone,
            None,
            uploads,
            mail=upload,
            ruled=True,
            is_last=True,
            is_local=True,
        )
