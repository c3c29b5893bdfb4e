"""Short flights of a small swarm in one process, and what of them is not of the clock."""

from typing import Any

from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.net import keys
from meanflock.swarm.scenario import Scenario, load
from reproduction.grid import Method

RUN = "engine-test"
NUMBER = keys.fingerprint(RUN)
UAVS = 6
SECONDS = 30


def scenario(method: Method | str, *settings: str) -> Scenario:
    fixed = [f"uavs={UAVS}", f"duration={SECONDS}", 'stop="duration"', "federation.period=25"]
    return load(None, [*fixed, *settings], method=str(method))


def fly(flown: Scenario, **options: Any) -> dict[str, Any]:
    return Engine(flown, RUN, **options).complete()


def steady(summary: dict[str, Any]) -> dict[str, Any]:
    """What must not depend on the machine or on how the swarm is cut into nodes."""
    volatile = {"wall_time_s", "real_time_factor", "wire_bytes", "dropped_messages", "radio"}
    radio = {k: v for k, v in summary["radio"].items() if k != "traffic"}
    traffic = {
        name: {k: v for k, v in bill.items() if k != "wire_bytes"} for name, bill in summary["radio"]["traffic"].items()
    }
    return {**{k: v for k, v in summary.items() if k not in volatile}, "radio": radio, "traffic": traffic}


INT8 = ("federation.payload=int8", "federation.broadcast_payload=int8")
