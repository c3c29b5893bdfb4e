"""One leader averages the uploads of all participants, as the paper has it."""

from meanflock.federation.topology.base import Hop, Topology
from meanflock.swarm.wire.messages import FrameKind


class LeaderTopology(Topology):
    """Participants upload to the leader's UAV, or to a station, which broadcasts the average to all."""

    name = "leader"
    bears_groups = True
    bears_clusters = False
    bears_station = True

    def hops(self) -> tuple[Hop, ...]:
        scenario, codecs = self.scenario, self.codecs
        upload = Hop(FrameKind.UPLOAD, 0, "agent", scenario.members, codec=codecs.upload, **self.to_seat())
        after = self.ticks(upload)
        spread = Hop(
            FrameKind.GLOBAL, after, "leader", self.seats, None, codecs.broadcast, "models", by_station=self.by_station
        )
        ticks = after + self.ticks(spread)
        if ticks > scenario.period_ticks and self.must_end(codecs.upload):
            raise ValueError(
                f"`federation.period` {scenario.period_ticks} has no room for a round of {ticks} ticks, in which "
                f"models go in {codecs.upload.count} fragment{'s' * (codecs.upload.count > 1)}; take at least {ticks}"
            )
        return upload, spread
