"""A scenario whose rounds cannot work is bad input of one line, before take-off."""

import pytest

import meanflock as mf
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import load
from tests.federation.plugins import SLOW, Long, Ring

TWO, NEIGHBOURS, RING = "federation.clusters=2", "federation.topology=neighbours", f"federation.topology={Ring.name}"
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
    mf.register(Ring)
    mf.register(Long)
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
