"""Links in the telemetry: all but delivered states, and a sample of those."""

from typing import Any

import numpy as np
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.swarm.scenario import load
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import FrameKind
from meanflock.worldsim.reporting import MAX_WAITING_BYTES, STATE_LINKS_EVERY_TICKS


@pytest.mark.parametrize(
    ("method", "changes"),
    [
        ("hjb", []),
        ("hjb", ["radio.target_snr_db=60"]),  # nothing is lost
        ("mfgfl-hf", ["federation.state_period=3", "federation.period=7"]),
        ("mfgfl-hf", ["federation.period=7"]),
    ],
)
def test_telemetry_has_all_outages_and_models_and_a_sample_of_states(method: str, changes: list[str]) -> None:
    flown = load(None, ["uavs=5", "duration=6", "radio.target_snr_db=77", *changes], method=method)
    engine, used = Engine(flown, "telemetry", sinks=[kept := Kept()]), []
    send = engine.world.air.send

    def noted(*given: Any) -> np.ndarray:
        used.append(send(*given).copy())
        return used[-1]

    engine.world.air.send = noted  # type: ignore[method-assign]
    for _ in engine.fly():
        pass
    engine.world.finish()
    links = np.concatenate(used)
    sampled = (links[:, 0] + 1) % STATE_LINKS_EVERY_TICKS == 0
    expected = links[sampled | (links[:, 4] < 0) | (links[:, 3] != FrameKind.STATE)]
    np.testing.assert_array_equal(np.concatenate([block.links for block in kept.blocks]), expected)
    assert sampled.any()
    assert (links[:, 4] < 0).any() == ("radio.target_snr_db=60" not in changes)


@pytest.mark.parametrize("uavs", [9_000, 60_000])
def test_blocks_of_a_large_swarm_fit_into_a_message_and_several_may_wait(uavs: int) -> None:
    flown = load(None, [f"uavs={uavs}", "duration=3"], method="cruise")
    engine = Engine(flown, "blocks", sinks=[kept := Kept()])
    for _ in engine.fly():
        pass
    engine.world.finish()
    sizes = [len(control.encode(block)) for block in kept.blocks]
    assert sum(len(block.states) for block in kept.blocks) == 31
    assert max(sizes) < min(control.MAX_BYTES, MAX_WAITING_BYTES) // 3
