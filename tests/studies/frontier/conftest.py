"""Frontiers of a small mission: short flights, and flights whose collisions follow a rule."""

import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from meanflock.studies.leaderboard import flights
from meanflock.swarm.scenario import Scenario

NEAR = """
uavs = 2
duration = 2.0
stop = "duration"
[start]
centre = [12.0, 9.0]
"""


@pytest.fixture
def near(tmp_path: Path) -> str:
    (tmp_path / "near.toml").write_text(NEAR)
    return "near.toml"


@pytest.fixture
def ruled(monkeypatch: pytest.MonkeyPatch) -> list[Scenario]:
    """Replaces flights: an event that is sent once fails in every third flight, beyond an outage of 40 % one that is
    sent twice fails, too, and `plan` always does. Returns the scenarios that were asked for.
    """
    asked: list[Scenario] = []
    monkeypatch.setattr(flights, "fly", following(asked))
    return asked


def following(asked: list[Scenario]) -> Callable[[Scenario], dict[str, Any]]:
    """The rule of `ruled`, which appends each scenario to `asked`."""

    def fly(flown: Scenario) -> dict[str, Any]:
        asked.append(flown)
        rule = flown.sharing.rule
        kbit = 100.0 if rule.broadcast == "tick" else 10.0 * rule.repeats + 20.0 * rule.velocity_delta_m_s
        weak = rule.broadcast == "event" and rule.repeats <= (2 if flown.radio.target_snr_db > 76.3 else 1)
        noise = zlib.crc32(json.dumps([flown.method, rule.repeats, flown.seed]).encode()) % 3
        collides = flown.method == "plan" or (weak and noise == 0)
        bits = {"total": 3200.0 if flown.method == "plan" else 1e3 * kbit + flown.seed % 7}
        return {
            "collisions_all": int(collides),
            "obstacle_hits": 0,
            "bits_to_arrival": bits,
            "arrived": flown.uavs,
            "uavs": flown.uavs,
        }

    return fly
