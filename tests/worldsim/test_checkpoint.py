"""Checkpoints that are too long for one block of telemetry."""

from pathlib import Path

import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.scenario import load
from meanflock.worldsim import checkpoint
from meanflock.worldsim.checkpoint import Assembly, split
from tests.faults.dying import dead, resumed


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
