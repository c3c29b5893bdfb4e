"""Plug-ins of users for tests of the federation."""

from typing import Any

import numpy as np

import meanflock as mf
from meanflock.federation import coding
from meanflock.federation.topology.base import Hop, Topology
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind
from tests.agent.large_model import Large
from tests.pages import script_of

Momentum = script_of("momentum", "examples").Momentum  # a rule with a state
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


class Long(Large):
    """Its model, a part of which pulls the UAV, shrinks from round to round, so that there is something to average."""

    name = "long"
    period_ticks = 20

    class Options(mf.Options, frozen=True):
        length: int = 3000
        decay: float = 0.999
        by_samples: bool = False

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.parameters, self.weights = options.length, 0
        self.parts = (options.length // 3, options.length - options.length // 3)
        self.weighted = options.by_samples

    def init(self, uavs: np.ndarray, initial_states: np.ndarray) -> dict[str, Any]:
        models = [np.random.default_rng(int(uav)).normal(size=self.parameters) for uav in uavs]
        return {"model": np.stack(models), "samples": uavs + 1.0}

    def step(self, memory: dict[str, Any], tick: int, own: np.ndarray, received: Any) -> mf.Step:
        pull = memory["model"][:, :2] * 0.01
        after = {**memory, "model": memory["model"] * self.options.decay}
        return mf.Step(after, pull - 0.05 * own[:, :2] - 0.3 * own[:, 2:])

    def samples(self, memory: dict[str, Any]) -> np.ndarray:
        return memory["samples"]
