"""What the world sends: all links but delivered states, blocks that fit, and checkpoints in parts."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.swarm.scenario import load
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import FrameKind
from meanflock.worldsim import checkpoint
from meanflock.worldsim.checkpoint import Assembly, split
from meanflock.worldsim.reporting import MAX_WAITING_BYTES, STATE_LINKS_EVERY_TICKS
from tests.faults.dying import dead, resumed


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


@pytest.mark.parametrize(("uavs", "ticks"), [(9_000, 30), (60_000, 8)])  # blocks of 20 ticks, and of 6
def test_blocks_of_a_large_swarm_fit_into_a_message_and_several_may_wait(uavs: int, ticks: int) -> None:
    flown = load(None, [f"uavs={uavs}", f"duration={ticks / 10}"], method="cruise")
    engine = Engine(flown, "blocks", sinks=[kept := Kept()])
    for _ in engine.fly():
        pass
    engine.world.finish()
    sizes = [len(control.encode(block)) for block in kept.blocks]
    assert sum(len(block.states) for block in kept.blocks) == ticks + 1
    assert 5 < max(len(block.states) for block in kept.blocks) < ticks
    assert max(sizes) < min(control.MAX_BYTES, MAX_WAITING_BYTES) // 3


def test_a_long_checkpoint_is_sent_in_parts_and_joined(monkeypatch: pytest.MonkeyPatch) -> None:
    body = bytes(range(1, 100))
    assert split(body) == [body]
    monkeypatch.setattr(checkpoint, "PART_BYTES", 40)
    first, second, third = split(body)
    whole = Assembly()
    assert [whole.add(part) for part in (first, second, third)] == [None, None, body]
    assert [whole.add(part) for part in (first, third, second)] == [None, None, None]  # one is missing
    assert [whole.add(part) for part in (first, second, first, second, third)] == [None] * 4 + [body]
    assert whole.add(body) == body
    assert whole.begun


def test_a_run_whose_checkpoints_go_in_parts_resumes_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, "PART_BYTES", 500)
    flown = load(None, ["uavs=4", "duration=120", 'stop="duration"'], method="mfgfl-h")
    killed = dead(tmp_path, flown, 1150)
    assert resumed(killed)["trajectory_sha256"] == Engine(flown, "whole").complete()["trajectory_sha256"]
