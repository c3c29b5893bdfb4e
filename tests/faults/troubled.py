"""A controller for tests, whose UAVs fail in all ways that have an event: alone, together, and when nobody asks."""

from collections.abc import Sequence

import numpy as np

import meanflock as mf
from meanflock.swarm.events.nodes import FailedTraining

UNTRAINED, RAISES, BEYOND, IMPLAUSIBLE, KILLED, LANDED = (0, 7), (5, 1), (2,), 3, 6, 8

SETTINGS = (
    *("uavs=9", "seed=3", "duration=13", "stop=duration", "radio.target_snr_db=60", "federation.fraction=1.0"),
    *('groups=[{name="stay",count=8},{name="leave",count=1,leaves_at_s=3.0}]', "federation.leader=4"),
    "faults=[{kind='kill',tick=9,uavs=[6]},{kind='leader-loss',tick=14}]",
)


class Troubled(mf.Controller):
    """Flies on, and has no number where it has failed: then its memory is zero."""

    name = "troubled"
    parameters = 2
    period_ticks = 10

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> dict[str, np.ndarray]:
        return {"number": uavs + 1, "model": np.ones((len(uavs), 2))}

    def step(
        self, memory: dict[str, np.ndarray], tick: int, own: np.ndarray, received: Sequence[mf.Received]
    ) -> mf.Step:
        uav = memory["number"] - 1
        acceleration = np.zeros((len(own), 2))
        for one in uav[np.argsort(uav)]:
            if one < 0 or (tick >= 12 and one in RAISES) or (tick >= 40 and one in (KILLED, LANDED)):
                raise RuntimeError("no number" if one < 0 else f"UAV {one} gives up")
        if tick >= 12:
            acceleration[np.isin(uav, BEYOND)] = 1e40
        fails = [FailedTraining(one, f"no data for UAV {one}") for one in UNTRAINED if one in uav and tick in (12, 15)]
        refused = np.array([IMPLAUSIBLE] if tick >= 12 and (uav != IMPLAUSIBLE).any() else [], dtype=np.int32)
        return mf.Step(memory, acceleration, refused=refused, news=fails)

    def get(self, memory: dict[str, np.ndarray]) -> np.ndarray:
        return memory["model"]

    def set(self, memory: dict[str, np.ndarray], rows: np.ndarray, models: np.ndarray) -> dict[str, np.ndarray]:
        return memory
