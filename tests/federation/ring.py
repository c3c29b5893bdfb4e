"""The topology of a user: a ring of averages."""

import numpy as np

from meanflock.federation import coding
from meanflock.federation.topology.base import Hop, Topology
from meanflock.swarm.wire.messages import FrameKind

# A radio on which messages need up to five ticks, and many are lost.
SLOW = ("radio.coherence_time_s=0.1", "radio.latency_threshold_slots=5", "radio.target_snr_db=76")


class Ring(Topology):
    """Participants upload to the next UAV and to themselves; averages go one UAV further and replace models there."""

    name = "test-ring"

    def hops(self) -> tuple[Hop, ...]:
        scenario, uavs = self.scenario, self.scenario.uavs
        if uavs < 3:
            raise ValueError(f"`federation.topology` is {self.name}, but `uavs` is {uavs}; a ring has three or more")
        everyone = np.arange(uavs)
        following = np.sort(np.stack([everyone, (everyone + 1) % uavs], axis=-1), axis=-1)
        counted = coding.Counted(scenario.radio_payload, scenario.declared.parameters, np.full(uavs, 4))
        upload = Hop(FrameKind.UPLOAD, 0, "agent", everyone, following, coding.of_uploads(scenario, None))
        relay = Hop(FrameKind.RELAY, scenario.hop_ticks, "agent", everyone, following, counted, mail=upload)
        model = Hop(
            FrameKind.GLOBAL,
            2 * scenario.hop_ticks,
            "agent",
            everyone,
            everyone[:, None],
            coding.of_broadcasts(scenario, None),
            mail=relay,
            is_last=True,
        )
        return upload, relay, model
