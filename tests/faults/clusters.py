"""Swarms with clusters, and what their leader makes of a round."""

import numpy as np

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind
from tests.faults.conftest import Lab, scenario

FLOATS, PERIOD = 108, 20
CLEAR = ("radio.bits_per_float=64", "radio.target_snr_db=60")  # nothing is lost, nothing rounded
ROUGH = (  # three slots of eight, a third of a tick each: some are lost, the others take one to three ticks
    "radio.bits_per_float=64",
    "radio.coherence_time_s=0.03",
    "radio.bandwidth_hz=3333",
    "radio.target_snr_db=104.3",
)
SLOW = ("radio.coherence_time_s=0.03", "radio.target_snr_db=76")  # uploads take up to three ticks, some are lost


def swarm(*settings_: str, uavs: int = 12, clusters: int = 3) -> Scenario:
    return scenario(f"uavs={uavs}", f"federation.clusters={clusters}", *settings_)


def globals_of(lab: Lab) -> list[np.ndarray]:
    """The models that the leader of a flight broadcasts, by round."""
    heard: list[np.ndarray] = []
    lab.listen(lambda tick, batch: heard.append(batch.payload[0]) if batch.kind == FrameKind.GLOBAL else None)
    lab.fly()
    return heard
