"""Several stations receive the uploads, average over a wire, and each broadcasts to the UAVs that it serves."""

from meanflock.federation.topology.base import Hop
from meanflock.federation.topology.leader import LeaderTopology


class Stations(LeaderTopology):
    """Participants upload to the stations that serve them. These hand the models over a backhaul to the station where
    the leader averages, and each of them broadcasts the global model to the UAVs that it serves."""

    name = "stations"
    by_station = True

    def hops(self) -> tuple[Hop, ...]:
        federation = self.scenario.federation
        self.check_rounds()
        if federation.station is None:
            raise ValueError("`federation.topology` stations averages at a station; set `federation.station`")
        if federation.retries:
            raise ValueError(
                f"`federation.retries` is {federation.retries}, and stations repeat nothing, because a UAV may be "
                "served by another one by then; set 0"
            )
        return super().hops()
