"""The meter: the bill of a flight counts its frames and links."""

import tracemalloc
from typing import Any

import numpy as np
import pytest

from meanflock.channel.medium import Medium
from meanflock.channel.meter import Links, Meter
from meanflock.federation.schedule import Schedule
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import state
from meanflock.swarm.wire.messages import FrameKind
from tests.channel.frames import UAVS, frames, line, links_of, scenario
from tests.methods import FEDERATED, METHODS, PARTS

TICKS = 240
PERIOD = 50


@pytest.mark.parametrize("method", METHODS)
def test_a_transmission_costs_its_floats_and_every_copy_is_delivered_or_in_outage(method: str) -> None:
    flown = scenario(f"method={method}", f"duration={TICKS / 10}", 'stop="duration"', f"federation.period={PERIOD}")
    summary = Engine(flown, f"bill-{method}").complete()
    traffic: dict[str, Any] = summary["radio"]["traffic"]
    rounds = range(1, (TICKS - 1) // PERIOD + 1) if method in FEDERATED else range(0)
    leader = flown.federation.leader
    uploads = sum(int((Schedule(flown).participants(k) != leader).sum()) for k in rounds)
    model_bits = sum(PARTS.get(method, ())) * 32
    states = UAVS * TICKS if method == "hjb" else UAVS  # the mission plan is the first, then every tick

    assert summary["rounds"] == len(rounds)
    counts = [traffic[name]["transmissions"] for name in ("uplink", "broadcast", "state")]
    assert counts == [uploads, len(rounds), states]
    assert summary["payload_bits"] == {
        "uplink": uploads * model_bits,
        "relay": 0,
        "broadcast": len(rounds) * model_bits,
        "state": states * 4 * 32,
        "total": (uploads + len(rounds)) * model_bits + states * 128,
    }
    assert traffic["uplink"]["sent"] == uploads
    assert traffic["broadcast"]["sent"] == len(rounds) * (UAVS - 1)
    assert traffic["state"]["sent"] == (UAVS * (UAVS - 1) * (TICKS - 1) if method == "hjb" else 0)
    for name, bill in traffic.items():
        assert bill["sent"] == bill["delivered"] + bill["outages"]
        on_air = bill["payload_bits"] - (UAVS * 128 if name == "state" else 0)  # the plan came with the Welcome
        assert bill["wire_bytes"] * 8 >= on_air
        assert (bill["airtime_s"] > 0) == (on_air > 0)


def test_the_bill_is_that_of_the_links_that_were_used() -> None:
    """Senders fall silent, and UAVs leave the range and come back."""
    medium, everyone = Medium(scenario("radio.target_snr_db=77.5")), list(range(UAVS))
    near, apart = line(*everyone), line(0.0, 1.0, 2.0, 130.0, 131.0, 400.0)
    sent, outages, spent, airtime = np.zeros((UAVS, UAVS), int), np.zeros((UAVS, UAVS), int), 0, 0.0
    ticks = [(near, everyone), (near, everyone), (apart, everyone), (near, [0, 2, 5]), (apart, [0, 2, 5])] * 4
    for tick, (states, speakers) in enumerate(ticks):
        along = states[:, state.X]
        records = medium.send(tick, [frames(FrameKind.STATE, speakers, 4)], states)
        assert records[:, 1:3].tolist() == [
            [source, target]
            for source in speakers
            for target in everyone
            if 0 < abs(along[source] - along[target]) < 100
        ]
        assert (records[:, 0] == tick).all()
        through = {(source, target) for _, source, target, _, slots in records.tolist() if slots > 0}
        assert links_of(medium.due(tick + 1)) == through
        for _, source, target, _, slots in records.tolist():
            sent[source, target] += 1
            outages[source, target] += slots < 0
            spent += abs(slots)
        airtime += sum(np.abs(records[records[:, 1] == one, 4]).max(initial=0) for one in speakers) * 5e-5
    bill = medium.meter.traffic[FrameKind.STATE]
    assert 0 < bill.outages == outages.sum() < bill.sent == sent.sum()
    assert (bill.transmissions, bill.slots) == (sum(len(speakers) for _, speakers in ticks), spent)
    assert bill.delivered_slots == spent - outages.sum() * 8
    assert bill.airtime_s == pytest.approx(airtime)
    used = zip(*np.nonzero(sent), strict=True)
    assert medium.meter.links() == [[s, t, sent[s, t], outages[s, t]] for s, t in used]


def test_a_large_swarm_takes_memory_for_links_that_are_used_only() -> None:
    """Of 10⁴ UAVs a table of all pairs would take 400 MB, and a checkpoint would look through it."""
    uavs, leader = 10_000, 7
    meter = Meter(scenario().radio, uavs)
    senders = np.setdiff1d(np.arange(uavs), [leader])
    tracemalloc.start()
    try:
        for sources in (senders[::2], senders, senders[:5]):
            rows, to = np.arange(len(sources)), np.full(len(sources), leader)
            links = Links.between(FrameKind.UPLOAD, sources, rows, to, uavs)
            for _ in range(2):
                meter.count(FrameKind.UPLOAD, 1, links, np.ones(len(sources), dtype=int), sources != 2, None)
        snapshot = meter.snapshot()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 16 * 2**20
    times = np.isin(senders, senders[::2]) * 2 + 2 + (senders < senders[5]) * 2
    assert snapshot["links"].tolist() == [[s, leader, n, n * (s == 2)] for s, n in zip(senders, times, strict=True)]
    again = Meter(scenario().radio, uavs)
    again.restore(snapshot)
    again.count(FrameKind.UPLOAD, 1, links, np.ones(5, dtype=int), np.ones(5, dtype=bool), None)
    assert again.links()[0] == [0, leader, 7, 0]
