"""Clusters: the bounds of their number, and the form of a relay."""

import numpy as np
import pytest

from meanflock.federation.coding import Counted
from meanflock.swarm.scenario import Scenario, load


def scenario(uavs: int = 12, clusters: int = 3, *more: str, method: str = "mfgfl-h") -> Scenario:
    return load(None, [f"uavs={uavs}", f"federation.clusters={clusters}", *more], method=method)


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
