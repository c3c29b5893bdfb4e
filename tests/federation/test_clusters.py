"""Clusters: the head of each UAV, the scenarios that are refused, and the form of a relay."""

import numpy as np
import pytest

from meanflock.federation.coding import Counted
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load


def scenario(uavs: int = 12, clusters: int = 3, *more: str, method: str = "mfgfl-h") -> Scenario:
    return load(None, [f"uavs={uavs}", f"federation.clusters={clusters}", *more], method=method)


REFUSED = {
    "more clusters than UAVs": (("uavs=4", "federation.clusters=5"), "mfgfl-h", ("`uavs` is 4", "at least one")),
    "no cluster at all": (("federation.clusters=0",), "mfgfl-h", ("federation.clusters", ">= 1")),
    "a method without rounds": (("federation.clusters=2",), "mfg", ("`method` mfg", "mfgfl-hf")),
    "a rule that must see every upload": (
        ("federation.clusters=2", "federation.aggregation=median"),
        "mfgfl-h",
        ("`federation.aggregation` median", "fedavg"),
    ),
    "no room for two hops": (
        ("federation.clusters=2", "federation.period=8", "radio.coherence_time_s=0.05"),
        "mfgfl-h",
        ("`federation.period` 8", "up to 8 ticks in all", "at least 9"),
    ),
    "more models than half a float counts": (
        ("uavs=4100", "federation.clusters=2", "radio.bits_per_float=16"),
        "mfgfl-h",
        ("2050 UAVs", "16-bit", "2048"),
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_clusters_that_cannot_work_are_bad_input(what: str) -> None:
    asked, method, parts = REFUSED[what]
    with pytest.raises(BadInput) as caught:
        load(None, asked, method=method)
    assert len(str(caught.value).splitlines()) == 1
    for part in ("federation.clusters", *parts):
        assert part in str(caught.value)


def test_clusters_at_the_bounds_are_accepted_and_one_leaves_no_trace_in_the_hash() -> None:
    scenario(4, 4)
    scenario(12, 3, "federation.period=9", "radio.coherence_time_s=0.05")
    scenario(4096, 2, "radio.bits_per_float=16")
    scenario(100_000, 2)
    assert load(None, ["federation.aggregation=median", "federation.clusters=1"], method="hjb").federation.clusters == 1
    assert scenario(12, 1).sha256() == load(None, ["uavs=12"], method="mfgfl-h").sha256()
    assert scenario(12, 2).sha256() != scenario(12, 1).sha256()


def relay(flight: Scenario) -> Counted:
    coding = flight.hops[1].coding
    assert isinstance(coding, Counted)
    return coding


@pytest.mark.parametrize("bits", [16, 32, 64])
@pytest.mark.parametrize(("method", "floats"), [("mfgfl-h", 108), ("mfgfl-f", 138), ("mfgfl-hf", 246)])
def test_a_relay_is_the_model_and_one_more_float(bits: int, method: str, floats: int) -> None:
    coding = relay(scenario(12, 3, f"radio.bits_per_float={bits}", "federation.payload=int8", method=method))
    assert coding.bits == (floats + 1) * bits
    written = coding.write(np.full((2, floats), 7.0), np.array([[3.0], [1.0]]))
    assert written.nbytes * 8 == 2 * coding.bits
    averages = coding.received(written)
    assert (averages.values == 7.0).all()
    assert averages.weights.tolist() == [3.0, 1.0]
    coding.check(np.array([0, 8], np.int32), written)
    beyond = coding.write(np.full((1, floats), 1e300), np.ones((1, 1)))
    assert coding.valid(beyond).tolist() == [bits == 64]
