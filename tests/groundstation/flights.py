"""Short flights of a small swarm in one process."""

from typing import Any

from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.net import keys
from meanflock.swarm.scenario import Scenario, load

RUN = "engine-test"
NUMBER = keys.fingerprint(RUN)
UAVS = 6


def scenario(method: str, *settings: str) -> Scenario:
    fixed = [f"uavs={UAVS}", "duration=30", 'stop="duration"', "federation.period=25"]
    return load(None, [*fixed, *settings], method=method)


def fly(flown: Scenario, **options: Any) -> dict[str, Any]:
    return Engine(flown, RUN, **options).complete()


INT8 = ("federation.payload=int8", "federation.broadcast_payload=int8")
