"""Every UAV averages what it receives: no leader, one transmission for each upload."""

from meanflock.federation.topology.base import Hop, Topology
from meanflock.swarm.wire.messages import FrameKind


class Neighbours(Topology):
    """Participants broadcast their models; each UAV averages its own model with those that it received.

    An upload reaches UAVs within `federation.range_m`, else within `radio.range_m`, and is transmitted once.
    """

    name = "neighbours"
    bears_groups = True
    bears_clusters = False
    bears_station = True

    def hops(self) -> tuple[Hop, ...]:
        scenario = self.scenario
        self.check_rounds()
        everyone, codec = scenario.members, self.codecs.upload
        reach = scenario.federation.range_m or scenario.radio.range_m
        upload = Hop(FrameKind.UPLOAD, 0, "agent", everyone, None, codec, range_m=reach)
        ticks = self.ticks(upload)
        if scenario.period_ticks <= ticks:
            raise ValueError(
                f"`federation.period` {scenario.period_ticks} has no room for uploads of up to {ticks} ticks; "
                f"take at least {ticks + 1}"
            )
        return upload, Hop(FrameKind.GLOBAL, ticks, "agent", everyone, None, codec, "models", is_local=True)
