"""One process or many: the same scenario and seed fly the same trajectory, and who is lost costs nobody else."""

import os
import subprocess
import sys
from typing import Any

import msgspec
import numpy as np
import pytest

from meanflock.channel.link import slot_success
from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Delivery
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Finished, Telemetry
from reproduction.grid import Method
from tests.groundstation.flights import INT8, RUN, UAVS, fly, scenario, steady
from tests.polling import DEADLINE_S


def test_the_seed_and_nothing_else_decides_the_trajectory() -> None:
    short = ("duration=4",)
    one = fly(scenario("mfgfl-h", *short))
    assert steady(one) == steady(fly(scenario("mfgfl-h", *short)))
    hashes = {fly(scenario("mfgfl-h", *short, f"seed={seed}"))["trajectory_sha256"] for seed in (1, 2, 3)}
    assert one["trajectory_sha256"] in hashes
    assert len(hashes) == 3


@pytest.mark.parametrize("method", Method)
@pytest.mark.parametrize("uavs", [1, 7])
def test_a_swarm_of_one_and_of_an_odd_number_flies_and_its_summary_is_plain_json(method: Method, uavs: int) -> None:
    flown = scenario(method, f"uavs={uavs}", "duration=6")
    summary = fly(flown, uavs_per_node=2)
    assert summary["ticks"] == 60
    assert summary["uavs"] == uavs
    assert msgspec.json.decode(msgspec.json.encode(summary))["trajectory_sha256"] == summary["trajectory_sha256"]
    assert (summary["phi_C_distinct"] is None) == (uavs == 1)
    assert not summary["dropped_messages"]


@pytest.mark.parametrize("bits", [16, 64])
def test_the_radio_s_width_changes_the_bill_and_the_flight_still_flies(bits: int) -> None:
    summary = fly(scenario("mfgfl-hf", f"radio.bits_per_float={bits}", "duration=8"), uavs_per_node=3)
    assert summary["rounds"] + summary["rounds_void"] == 3
    assert summary["payload_bits"]["broadcast"] == summary["rounds"] * 246 * bits > 0
    assert summary["payload_bits"]["state"] == UAVS * 4 * bits


@pytest.mark.parametrize(
    ("method", "settings", "uplink", "broadcast", "slots"),
    [
        ("mfgfl-hf", INT8, 2096, 2096, 1),
        ("mfgfl-hf", ("federation.payload=int8", "federation.broadcast_payload=float16"), 2096, 3936, None),
        ("mfgfl-h", ("federation.payload=float16",), 1728, 3456, None),
        ("mfgfl-f", ("federation.payload=int8", "radio.bits_per_float=64"), 1168, 8832, None),
    ],
)
def test_narrow_payloads_are_billed_to_the_bit_and_fly_the_same_however_the_swarm_is_cut(
    method: str, settings: tuple[str, ...], uplink: int, broadcast: int, slots: int | None
) -> None:
    flown = scenario(method, "radio.target_snr_db=76", "duration=9", *settings)
    summaries = [fly(flown, uavs_per_node=rows) for rows in (1, 4)]
    assert steady(summaries[0]) == steady(summaries[1])
    for summary in summaries:
        traffic = summary["radio"]["traffic"]
        assert traffic["uplink"]["payload_bits"] == uplink * traffic["uplink"]["transmissions"] > 0
        assert traffic["broadcast"]["payload_bits"] == broadcast * summary["rounds"] > 0
        assert summary["wire_bytes"] * 8 > summary["payload_bits"]["uplink"]
        assert not summary["dropped_messages"]
        if slots is not None:  # closed forms are of the bits that were sent: p = P[SNR ≥ η] a slot, D_M = 8 of them
            assert traffic["uplink"]["outage_rate_theory"] == pytest.approx(one_slot_outage(flown), rel=1e-9)


def one_slot_outage(flown: Scenario) -> float:
    """(1 − p)^D_M: nothing got through in any of the slots."""
    success = float(slot_success(flown.radio, np.array([1.0]))[0])
    return (1.0 - success) ** flown.radio.latency_threshold_slots


# -- what the telemetry says --------------------------------------------------------------------------------------


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
    assert events[0] == "joined"
    assert events[-1] == "finished"


# -- who looks, and who does not -----------------------------------------------------------------------------------


def test_an_observer_sees_take_off_and_every_tick_and_nobody_listens() -> None:
    engine, ticks, bits = Engine(scenario("mfgfl-h", "duration=4"), RUN), [], []

    def look(seen: Engine) -> None:
        ticks.append(seen.world.flight.tick)
        bits.append(seen.world.air.meter.total("payload_bits"))

    summary = engine.complete(look)
    assert ticks == list(range(41))
    assert bits[0] == UAVS * 4 * 32  # the mission plan
    assert bits[-1] == summary["payload_bits"]["total"] > bits[0]
    assert engine.station is None
    assert not engine.world.outbox.waiting
    assert summary["telemetry_blocks_dropped"] == 0


def test_without_a_listener_no_block_is_encoded_and_the_flight_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    flown = scenario("mfgfl-h", "duration=25")
    told = fly(flown, sinks=[Kept()])
    encode, kinds = control.encode, set()

    def listed(message: Any) -> bytes:
        kinds.add(type(message))
        return encode(message)

    monkeypatch.setattr(control, "encode", listed)
    untold = fly(flown)
    assert steady(told) == steady(untold)
    assert kinds
    assert not kinds & {Telemetry, Finished}


@pytest.mark.parametrize("rows", [1, 4, None])
def test_what_has_been_learned_is_seen_and_carried_over_however_the_swarm_is_cut(rows: int | None) -> None:
    flown = scenario("mfgfl-hf", "duration=6", "radio.target_snr_db=76")
    whole, cut = Engine(flown, RUN), Engine(flown, RUN, uavs_per_node=rows)
    start = cut.models
    assert start.shape == (UAVS, 246)
    before, after = whole.complete(), cut.complete()
    np.testing.assert_array_equal(cut.models, whole.models)
    assert (cut.models != start).any(axis=-1).all()
    again = [fly(flown, memory={"weights": whole.models}, uavs_per_node=n) for n in (rows, None)]
    assert steady(again[0]) == steady(again[1])
    assert again[0]["trajectory_sha256"] != before["trajectory_sha256"] == after["trajectory_sha256"]


# -- losses -------------------------------------------------------------------------------------------------------


def test_a_node_whose_token_vanishes_is_lost_with_its_uavs_and_the_flight_goes_on() -> None:
    engine = Engine(scenario("mfgfl-h", "duration=6"), RUN, uavs_per_node=2)
    for tick in engine.fly():
        if tick == 20:
            for _ in range(2):
                engine.world.handle(Delivery("gone", keys.alive(RUN, "agent", "agent-2")))
    summary = engine.world.finish()
    assert (summary["ticks"], summary["lost"]) == (60, 2)
    assert engine.world.flight.status.tolist() == [0, 0, 2, 2, 0, 0]
    assert summary["rounds"] == 2


def test_without_its_leader_the_swarm_flies_on_and_has_no_more_rounds() -> None:
    engine = Engine(scenario("mfgfl-h", "duration=8"), RUN)
    for tick in engine.fly():
        if tick == 40:
            engine.world.handle(Delivery("gone", keys.alive(RUN, "leader", "leader")))
    summary = engine.world.finish()
    assert (summary["ticks"], summary["lost"], summary["rounds"]) == (80, 0, 1)


@pytest.mark.parametrize(
    ("uavs", "realtime", "ticks"), [(2, None, 1000), (60, None, 400), (1000, None, 100), (2, 1e3, 100)]
)
def test_a_checkpoint_is_worth_about_as_much_flight_whatever_the_swarm(
    uavs: int, realtime: float | None, ticks: int
) -> None:
    flown = load(None, [f"uavs={uavs}", "duration=1"], method="offline")
    assert Engine(flown, RUN, sinks=[Kept()], realtime=realtime).world._checkpoint_every == ticks


WATCH = """
import os, sys

class Watch:
    def find_spec(self, name, *_):
        if name == "numpy":
            print(os.environ.get("OPENBLAS_NUM_THREADS"), os.environ.get("OMP_NUM_THREADS"))

sys.meta_path.insert(0, Watch())
import {module}, numpy
"""


@pytest.mark.parametrize(
    "module",
    ["groundstation.cli.__main__", *(f"{room}.__main__" for room in ("agent", "leader", "worldsim", "groundstation"))],
)
def test_every_process_of_ours_holds_blas_to_one_thread_before_numpy_is_there(module: str) -> None:
    """Whoever flies from Python decides this for himself: `import meanflock` sets no variable."""
    code = WATCH.replace("{module}", f"meanflock.{module}")
    env = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env, timeout=DEADLINE_S)
    assert done.stdout.strip() == "1 1", done.stderr
