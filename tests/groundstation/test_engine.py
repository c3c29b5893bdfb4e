"""The engine in one process: telemetry, observers, and the models that it carries from flight to flight."""

import re
import sys

import msgspec
import numpy as np
import pytest

from meanflock.channel.link import slot_success
from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.swarm.scenario import Scenario, load
from tests.commands import printed
from tests.golden.flights import steady
from tests.groundstation.flights import INT8, RUN, UAVS, fly, scenario
from tests.methods import METHODS
from tests.sources import ROOT, text


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("uavs", [1, 7])
def test_a_swarm_of_one_and_of_an_odd_number_fly(method: str, uavs: int) -> None:
    summary = fly(scenario(method, f"uavs={uavs}", "duration=3"), uavs_per_node=2)
    assert (summary["ticks"], summary["uavs"]) == (30, uavs)
    assert (summary["phi_C_distinct"] is None) == (uavs == 1)
    assert not summary["dropped_messages"]


@pytest.mark.parametrize(
    ("method", "settings", "uplink", "broadcast"),
    [
        ("mfgfl-hf", INT8, 2096, 2096),
        ("mfgfl-hf", ("federation.payload=int8", "federation.broadcast_payload=float16"), 2096, 3936),
        ("mfgfl-f", ("federation.payload=int8", "radio.bits_per_float=64"), 1168, 8832),
        ("mfgfl-hf", ("radio.bits_per_float=16",), 3936, 3936),
    ],
)
def test_models_are_billed_to_the_bit(method: str, settings: tuple[str, ...], uplink: int, broadcast: int) -> None:
    flown = scenario(method, "radio.target_snr_db=76", "duration=9", *settings)
    summary = fly(flown, uavs_per_node=4)
    traffic = summary["radio"]["traffic"]
    assert traffic["uplink"]["payload_bits"] == uplink * traffic["uplink"]["transmissions"] > 0
    assert traffic["broadcast"]["payload_bits"] == broadcast * summary["rounds"] > 0
    assert summary["payload_bits"]["state"] == UAVS * 4 * flown.radio.bits_per_float
    assert summary["wire_bytes"] * 8 > summary["payload_bits"]["uplink"]
    if settings == INT8:  # a transmission of so few bits needs one slot
        assert traffic["uplink"]["outage_rate_theory"] == pytest.approx(one_slot_outage(flown), rel=1e-9)


def one_slot_outage(flown: Scenario) -> float:
    """(1 − p)^D_M: none of the slots delivers."""
    success = float(slot_success(flown.radio, np.array([1.0]))[0])
    return (1.0 - success) ** flown.radio.latency_threshold_slots


def test_the_telemetry_is_the_flight_row_by_row() -> None:
    kept = Kept()
    engine = Engine(scenario("mfgfl-hf", "duration=9.7"), RUN, sinks=[kept])
    expected = [engine.world.flight.states.copy()]
    expected += [engine.world.flight.states.copy() for _ in engine.fly()]
    summary = engine.world.finish()
    assert engine.station is not None
    assert engine.station.summary == msgspec.json.decode(msgspec.json.encode(summary))
    assert [block.block for block in kept.blocks] == list(range(len(kept.blocks)))
    np.testing.assert_array_equal(np.concatenate([block.states for block in kept.blocks]), expected)
    firsts = np.cumsum([0, *[len(block.states) for block in kept.blocks]])
    assert [block.first_tick for block in kept.blocks] == firsts[:-1].tolist()
    events = [event.kind for block in kept.blocks for event in block.events]
    assert events.count("round") == summary["rounds"] == 3
    assert (events[0], events[-1]) == ("joined", "finished")


@pytest.mark.parametrize("rows", [1, 4])
def test_models_are_read_and_carried_over_however_the_swarm_is_divided(rows: int) -> None:
    flown = scenario("mfgfl-hf", "duration=6", "radio.target_snr_db=76")
    whole, divided = Engine(flown, RUN), Engine(flown, RUN, uavs_per_node=rows)
    start = divided.models
    assert start.shape == (UAVS, 246)
    before = whole.complete()
    divided.complete()
    np.testing.assert_array_equal(divided.models, whole.models)
    assert (divided.models != start).any(axis=-1).all()
    again = [fly(flown, memory={"weights": whole.models}, uavs_per_node=n) for n in (rows, None)]
    assert steady(again[0]) == steady(again[1])
    assert again[0]["trajectory_sha256"] != before["trajectory_sha256"]


@pytest.mark.parametrize(
    ("uavs", "realtime", "ticks"), [(2, None, 1000), (60, None, 400), (1000, None, 100), (2, 1e3, 100)]
)
def test_checkpoints_are_as_frequent_as_a_flight_is_slow(uavs: int, realtime: float | None, ticks: int) -> None:
    flown = load(None, [f"uavs={uavs}", "duration=1"], method="offline")
    assert Engine(flown, RUN, sinks=[Kept()], realtime=realtime).world._checkpoint_every == ticks


WATCH = """
import os, sys

class Watch:
    def find_spec(self, name, *_):
        if name == "numpy":
            print(os.environ.get("OPENBLAS_NUM_THREADS"), os.environ.get("OMP_NUM_THREADS"))

sys.meta_path.insert(0, Watch())
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.pop(name, None)
import meanflock.groundstation.cli.__main__, numpy
"""


def test_every_process_limits_blas_to_one_thread_before_it_imports_numpy() -> None:
    for room in ("groundstation/cli", "agent", "leader", "worldsim", "groundstation"):
        names = re.findall(r"^\s*(?:import|from) (meanflock\S*|numpy)", text(ROOT / room / "__main__.py"), re.MULTILINE)
        assert names[0] == "meanflock.swarm.one_thread", room
    assert printed(sys.executable, "-c", WATCH).strip() == "1 1"
