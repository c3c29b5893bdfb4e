"""The medium: targets of each kind of frame, the tick in which it is delivered, and the bill of frames and links."""

import math
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


def test_each_kind_of_frame_goes_to_its_targets() -> None:
    medium = Medium(scenario("federation.leader=2", "radio.target_snr_db=60"))
    states = line(0.0, 99.9, 100.0, 100.1, 200.0, 1e6)
    uploads, model = frames(FrameKind.UPLOAD, [0, 2, 5], 246, 1), frames(FrameKind.GLOBAL, [2], 246, 1)
    records = medium.send(5, [frames(FrameKind.STATE, [0, 4], 4), model, uploads], states)
    by_radio = {
        kind: {(int(s), int(t)) for _, s, t, k, slots in records if k == kind and slots > 0} for kind in FrameKind
    }
    assert by_radio[FrameKind.UPLOAD] == {(0, 2), (5, 2)}
    assert by_radio[FrameKind.GLOBAL] == {(2, t) for t in (0, 1, 3, 4, 5)}
    assert by_radio[FrameKind.STATE] == {(0, 1), (0, 2), (4, 2), (4, 3)}
    assert (records[:, 0] == 5).all()
    delivered = medium.due(6)
    of_kind = {kind: links_of([batch for batch in delivered if batch.kind == kind]) for kind in FrameKind}
    # On board there is no radio, but the leader has its own upload and UAV h the global model.
    assert of_kind[FrameKind.UPLOAD] == by_radio[FrameKind.UPLOAD] | {(2, 2)}
    assert of_kind[FrameKind.GLOBAL] == by_radio[FrameKind.GLOBAL] | {(2, 2)}
    assert of_kind[FrameKind.STATE] == by_radio[FrameKind.STATE]


def test_models_fail_beyond_the_range_of_the_federation() -> None:
    radio = "radio.path_loss_exponent=0.05"
    states, sent = line(0.0, 10.0, 19.0, 21.0, 30.0, 500.0), frames(FrameKind.UPLOAD, [0, 1, 2, 3, 4, 5], 246, 1)
    near, anywhere = Medium(scenario("federation.range_m=20", radio)), Medium(scenario(radio))
    anywhere_links = anywhere.send(5, [sent], states)
    links = near.send(5, [sent], states)
    limit = near.meter.radio.latency_threshold_slots
    np.testing.assert_array_equal(links[:2], anywhere_links[:2])
    np.testing.assert_array_equal(links[2:, 4], [-limit] * 3)
    bill, free = near.meter.traffic[FrameKind.UPLOAD], anywhere.meter.traffic[FrameKind.UPLOAD]
    assert (bill.sent, bill.payload_bits) == (free.sent, free.payload_bits)
    assert 3.0 < bill.expected_outages < 3.0 + free.expected_outages
    nobody = Medium(scenario("federation.range_m=5", radio))
    assert not links_of([batch for _ in [nobody.send(5, [sent], states)] for batch in nobody.due(6)]) - {(0, 0)}


@pytest.mark.parametrize(
    ("dt", "theta", "slots"), [(0.1, 5e-5, 8), (0.125, 0.125, 8), (0.125, 0.1875, 12), (0.125, 1.0, 5)]
)
def test_a_frame_is_delivered_once_after_its_slots_or_never(dt: float, theta: float, slots: int) -> None:
    flown = scenario(
        f"dt={dt}",
        f"radio.coherence_time_s={theta}",
        f"radio.latency_threshold_slots={slots}",
        f"radio.bandwidth_hz={100 / theta}",
        f"radio.target_snr_db={75.5 + 10 * math.log10(2e6 * theta / 100)}",  # another band, the same chance
    )
    medium, states = Medium(flown), line(*range(UAVS))
    expected: dict[int, set[tuple[int, int, int]]] = {}
    outages, several = 0, 0
    for tick in range(0, 400, 2):
        for _, source, target, _, used in medium.send(tick, [frames(FrameKind.GLOBAL, [0], 246, tick)], states):
            if used < 0:
                outages += 1
                assert used == -slots
                continue
            due = tick + max(1, math.ceil(int(used) * theta / dt))
            several += due > tick + 1
            expected.setdefault(due, set()).add((tick, int(source), int(target)))
        expected.setdefault(tick + 1, set()).add((tick, 0, 0))  # on board
    assert outages
    assert bool(several) == (theta > dt / 8)
    rounds = Schedule(flown)  # a round closes when the slowest upload has arrived
    opened = flown.period_ticks
    assert next(t for t in range(opened, 1000) if rounds.closes(t)) == opened + max(1, math.ceil(slots * theta / dt))
    for tick in range(400 + math.ceil(slots * theta / dt) + 2):
        found = {(batch.round, *link) for batch in medium.due(tick) for link in links_of([batch])}
        assert found == expected.get(tick, set())


def test_the_order_of_kinds_leaves_no_trace() -> None:
    batches = [
        frames(FrameKind.UPLOAD, [0, 1, 4], 246, 1),
        frames(FrameKind.GLOBAL, [0], 246, 1),
        frames(FrameKind.STATE, [0, 2, 5], 4),
    ]
    one, other = (Medium(scenario("radio.target_snr_db=76")) for _ in range(2))
    for tick in range(50):
        np.testing.assert_array_equal(
            one.send(tick, batches, line(*range(UAVS))), other.send(tick, batches[::-1], line(*range(UAVS)))
        )
    assert one.meter.traffic == other.meter.traffic


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
