"""A federated flight is the same however it is flown, also in the topology of a user: a ring of averages."""

from typing import Any

import pytest

import meanflock as mf
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.scenario import Scenario, load
from meanflock.worldsim.checkpoint import EVERY_TICKS
from tests.federation.plugins import SLOW, Long, Momentum, Ring
from tests.telemetry import fly

UAVS = 9


@pytest.fixture(autouse=True)
def _registered() -> None:
    for plugin in (Ring, Momentum, Long):
        mf.register(plugin)


def scenario(*settings: str, method: str = "mfgfl-h") -> Scenario:
    fixed = [f"uavs={UAVS}", f"federation.topology={Ring.name}", "federation.period=20", "duration=35"]
    return load(None, [*fixed, 'stop="duration"', *settings], method=method, seed=5)


SILENT = "federation.upload_threshold=0.2"
MOMENTUM = "federation.aggregation=momentum"  # a rule with a state
LEADER, NEIGHBOURS = "federation.topology=leader", "federation.topology=neighbours"
CLUSTERS = ("federation.topology=clusters", "federation.clusters=2")
# A tick transmits one of a dozen fragments and more.
FRAGMENTS = ("radio.coherence_time_s=0.0125", "radio.bandwidth_hz=800", "radio.target_snr_db=109", "uavs=6")
FRAGMENTS += ("federation.fragment=3", "federation.period=45", "federation.fraction=1.0", "controller.length=360")
ROWS: dict[str, tuple[str, tuple[str, ...]]] = {
    "a ring": ("mfgfl-h", (*SLOW, "federation.payload=int8")),
    "clusters": ("mfgfl-h", (*SLOW, *CLUSTERS, SILENT)),
    "leader with a state": ("mfgfl-h", (*SLOW, LEADER, MOMENTUM)),
    "neighbours with states, some silent": ("mfgfl-h", (*SLOW, NEIGHBOURS, MOMENTUM, SILENT)),
    "fragments to a leader": ("long", (*FRAGMENTS, LEADER, "federation.payload=int8")),
    "fragments to heads": ("long", (*FRAGMENTS, *CLUSTERS)),
    "fragments to neighbours, some silent": ("long", (*FRAGMENTS, NEIGHBOURS, SILENT)),
    "fragments to neighbours with a median": ("long", (*FRAGMENTS, NEIGHBOURS, "federation.aggregation=median")),
}
STEADY = ("trajectory_sha256", "models_sha256", "payload_bits", "rounds", "rounds_void", "uploads_silent")
STEADY += ("weight_spread_final", "dropped_messages")


@pytest.mark.parametrize("name", ROWS)
def test_a_flight_is_the_same_in_any_number_of_nodes_and_resumed_within_a_round(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("meanflock.groundstation.launch.engine._CHECKPOINT_TICKS_AT_MOST", EVERY_TICKS)
    method, settings = ROWS[name]
    of = scenario(*settings, method=method)
    whole, record = fly(of)
    assert whole["rounds"] > 0
    assert len(whole["models_sha256"]) == 64
    assert (method == "long") == (of.hops[0].coding.count > 10)
    assert (SILENT in settings) == (whole["uploads_silent"] > 0)
    pasts = record.checkpoints[1:]
    assert [past.tick for past in pasts] == [101, 201, 301]  # a round is under way
    others = [fly(of, rows=2)[0], *(fly(of, resume=past)[0] for past in pasts)]
    for field in STEADY:
        assert [other[field] for other in others] == [whole[field]] * len(others), field


def test_a_ring_is_billed_by_the_hop_and_no_uav_pays_for_its_own_model_or_needs_a_leader() -> None:
    engine = Engine(scenario("federation.fraction=1.0", "radio.target_snr_db=60"), "ring", uavs_per_node=4)
    assert all(member.role == "agent" for member in engine.world.members.present)
    summary = engine.complete()
    traffic: dict[str, Any] = summary["radio"]["traffic"]
    assert traffic["uplink"]["transmissions"] == traffic["uplink"]["delivered"] == 17 * UAVS
    assert traffic["relay"]["payload_bits"] == 17 * UAVS * (108 + 1) * 32
    assert traffic["broadcast"]["sent"] == 0
