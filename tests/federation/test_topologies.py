"""A federated flight is the same however it is flown, also in a user's topology; rounds that cannot work fail early."""

from typing import Any

import pytest

import meanflock as mf
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.errors import BadInput
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


SILENT, DEADLINE = "federation.upload_threshold=0.2", "federation.deadline=0.2"
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
    "late uploads to a leader": ("mfgfl-h", (*SLOW, LEADER, DEADLINE)),
    "neighbours with states, some silent": ("mfgfl-h", (*SLOW, NEIGHBOURS, MOMENTUM, SILENT)),
    "fragments to a leader": ("long", (*FRAGMENTS, LEADER, "federation.payload=int8")),
    "fragments to heads": ("long", (*FRAGMENTS, *CLUSTERS)),
    "fragments to heads, weighted": ("long", (*FRAGMENTS, *CLUSTERS, "controller.by_samples=true")),
    "fragments to neighbours, some silent": ("long", (*FRAGMENTS, NEIGHBOURS, SILENT)),
    "fragments to neighbours with a median": ("long", (*FRAGMENTS, NEIGHBOURS, "federation.aggregation=median")),
}
STEADY = ("trajectory_sha256", "models_sha256", "payload_bits", "rounds", "rounds_void", "uploads_silent")
STEADY += ("weight_spread_final", "dropped_messages")


@pytest.mark.parametrize("name", ROWS)
def test_a_flight_is_the_same_in_any_number_of_nodes_and_resumed_within_a_round(name: str, monkeypatch) -> None:
    monkeypatch.setattr("meanflock.groundstation.launch.engine._CHECKPOINT_TICKS_AT_MOST", EVERY_TICKS)
    method, settings = ROWS[name]
    of = scenario(*settings, method=method)
    whole, record = fly(of)
    assert whole["rounds"] > 0
    assert len(whole["models_sha256"]) == 64
    assert (method == "long") == (of.hops[0].coding.count > 10)
    assert (SILENT in settings) == (whole["uploads_silent"] > 0)
    assert (DEADLINE in settings) == (whole["uploads_late"] > 0)
    pasts = record.checkpoints[1:]
    assert [past.tick for past in pasts] == [101, 201, 301]  # a round is under way
    others = [fly(of, rows=2)[0], *(fly(of, resume=past)[0] for past in pasts[1:])]
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


TWO, RING = "federation.clusters=2", f"federation.topology={Ring.name}"
MEDIAN, LONG, FRAGMENT = "federation.aggregation=median", "controller.length=100000", "federation.fragment=1"
BRIEF = ("federation.period=8", "radio.coherence_time_s=0.05")
QUIET = "federation.upload_threshold=0.1"
# Method, settings, and parts of the line.
REFUSED: list[tuple[str, tuple[str, ...], tuple[str, ...]]] = [
    ("mfgfl-h", ("uavs=4", "federation.clusters=5"), ("federation.clusters", "`uavs` is 4", "at least one")),
    ("mfgfl-h", ("federation.clusters=0",), ("federation.clusters", ">= 1")),
    ("mfg", (TWO,), ("federation.clusters", "`method` mfg", "mfgfl-hf")),
    ("mfgfl-h", (TWO, MEDIAN), ("federation.clusters", "`federation.aggregation` median", "fedavg")),
    ("mfgfl-h", (TWO, *BRIEF), ("federation.clusters", "`federation.period` 8", "up to 8 ticks in all", "at least 9")),
    ("mfgfl-h", (TWO, "uavs=4100", "radio.bits_per_float=16"), ("federation.clusters", "2050 UAVs", "16-bit", "2048")),
    ("mfgfl-h", (NEIGHBOURS, QUIET, MEDIAN), ("false uploads could be a majority",)),
    ("mfgfl-h", (NEIGHBOURS, "federation.upload_threshold=-1"), ("upload_threshold",)),
    ("mfgfl-h", (NEIGHBOURS, TWO), ("`federation.clusters` is 2, but `federation.topology` is neighbours",)),
    ("mfgfl-h", (NEIGHBOURS, "federation.period=1"), ("take at least 2",)),
    ("mfgfl-h", (NEIGHBOURS, "federation.period=5", *SLOW), ("no room for uploads of up to 5 ticks; take at least 6",)),
    ("plan", (NEIGHBOURS,), ("`method` plan has no rounds",)),
    ("mfgfl-h", (RING, "uavs=2"), ("a ring has three or more",)),
    ("mfgfl-h", ("federation.topology=test-rink",), ("did you mean",)),
    ("long", (LONG, "federation.period=3"), ("take at least 4",)),
    ("long", (FRAGMENT, "radio.bandwidth_hz=1000"), ("federation.fragment",)),
    ("long", (LONG, "federation.aggregation=krum"), ("krum",)),
]


@pytest.mark.parametrize(("method", "settings", "parts"), REFUSED)
def test_rounds_that_cannot_work_are_bad_input(method: str, settings: tuple[str, ...], parts: tuple[str, ...]) -> None:
    with pytest.raises(BadInput) as caught:
        Engine(load(None, ["uavs=6", "federation.fraction=1.0", *settings], method=method), "refused")
    assert len(str(caught.value).splitlines()) == 1
    for part in parts:
        assert part in str(caught.value)


def test_clusters_at_the_bounds_are_accepted_and_one_leaves_no_trace_in_the_hash() -> None:
    def flown(*settings: str) -> str:
        return load(None, settings, method="mfgfl-h").sha256()

    flown("uavs=4", "federation.clusters=4")
    flown(TWO, "federation.period=9", "radio.coherence_time_s=0.05")
    flown(TWO, "uavs=4096", "radio.bits_per_float=16")
    flown(TWO, "uavs=100000")
    assert load(None, [MEDIAN, "federation.clusters=1"], method="hjb").federation.clusters == 1
    assert flown("federation.clusters=1") == flown() != flown(TWO)
