"""The medium: which links carry a frame, when it is delivered, and its bill; channels of users, and memories.

Closed forms of one link: test_link.py.
"""

import math
import tracemalloc
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from meanflock.channel.base import Channel, Message
from meanflock.channel.medium import Medium
from meanflock.channel.meter import Links, Meter
from meanflock.federation.plan import plan_of
from meanflock.federation.schedule import Schedule
from meanflock.launch.engine import Engine
from meanflock.swarm import plugins, state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.stateful import restore, state_of
from meanflock.swarm.wire.messages import FrameKind, Frames, LinkColumn
from meanflock.testing import ConformanceError, check_channel
from tests.channel.bursts import Bursts
from tests.faults.dying import dead, resumed
from tests.golden.flights import steady
from tests.methods import FEDERATED, METHODS, PARTS

UAVS = 6


def scenario(*settings: str, **options: Any) -> Scenario:
    return load(None, [f"uavs={UAVS}", *settings], **options)


def line(*metres: float) -> state.States:
    """UAVs at rest along x."""
    states = np.zeros((len(metres), 4))
    states[:, 0] = metres
    return states


def frames(kind: FrameKind, source: list[int], floats: int, number: int = 0) -> Frames:
    payload = np.arange(len(source) * floats, dtype=np.float32).reshape(len(source), floats)
    return Frames(kind, number, np.array(source, dtype=np.int32), payload)


def links_of(batches: list[Frames]) -> set[tuple[int, int]]:
    """[source, target] of what was delivered, each once."""
    found = [
        (int(batch.source[row]), int(target))
        for batch in batches
        if batch.links is not None
        for row, target in batch.links
    ]
    assert len(found) == len(set(found))
    return set(found)


def test_each_kind_of_frame_goes_to_its_targets() -> None:
    medium = Medium(plan_of(scenario("federation.leader=2", "radio.target_snr_db=60")))
    states = line(0.0, 99.9, 100.0, 100.1, 200.0, 1e6)
    uploads, model = frames(FrameKind.UPLOAD, [0, 2, 5], 246, 1), frames(FrameKind.GLOBAL, [2], 246, 1)
    records = medium.send(5, [frames(FrameKind.STATE, [0, 4], 4), model, uploads], states)
    by_radio = {
        kind: {(int(s), int(t)) for _, s, t, k, _, through, _ in records if k == kind and through} for kind in FrameKind
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
    near, anywhere = Medium(plan_of(scenario("federation.range_m=20", radio))), Medium(plan_of(scenario(radio)))
    anywhere_links = anywhere.send(5, [sent], states)
    links = near.send(5, [sent], states)
    limit = near.meter.radio.latency_threshold_slots
    np.testing.assert_array_equal(links[:2], anywhere_links[:2])
    np.testing.assert_array_equal(links[2:, 4:], [[limit, 0, 0]] * 3)
    bill, free = near.meter.traffic[FrameKind.UPLOAD], anywhere.meter.traffic[FrameKind.UPLOAD]
    assert (bill.sent, bill.payload_bits) == (free.sent, free.payload_bits)
    assert 3.0 < bill.expected_outages < 3.0 + free.expected_outages
    nobody = Medium(plan_of(scenario("federation.range_m=5", radio)))
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
    medium, states = Medium(plan_of(flown)), line(*range(UAVS))
    expected: dict[int, set[tuple[int, int, int]]] = {}
    outages, several = 0, 0
    for tick in range(0, 400, 2):
        for _, source, target, _, used, through, _ in medium.send(
            tick, [frames(FrameKind.GLOBAL, [0], 246, tick)], states
        ):
            if not through:
                outages += 1
                assert used == slots
                continue
            due = tick + max(1, math.ceil(int(used) * theta / dt))
            several += due > tick + 1
            expected.setdefault(due, set()).add((tick, int(source), int(target)))
        expected.setdefault(tick + 1, set()).add((tick, 0, 0))  # on board
    assert outages
    assert bool(several) == (theta > dt / 8)
    for tick in range(400 + math.ceil(slots * theta / dt) + 2):
        found = {(batch.round, *link) for batch in medium.due(tick) for link in links_of([batch])}
        assert found == expected.get(tick, set())


TICKS = 240
PERIOD = 50


@pytest.mark.parametrize("method", METHODS)
def test_a_transmission_costs_its_floats_and_every_copy_is_delivered_or_in_outage(method: str) -> None:
    flown = scenario(f"method={method}", f"duration={TICKS / 10}", 'stop="duration"', f"federation.period={PERIOD}")
    summary = Engine(flown, f"bill-{method}").complete()
    traffic: dict[str, Any] = summary["radio"]["traffic"]
    rounds = range(1, (TICKS - 1) // PERIOD + 1) if method in FEDERATED else range(0)
    leader = flown.federation.leader
    uploads = sum(int((Schedule(plan_of(flown)).participants(k) != leader).sum()) for k in rounds)
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
    medium, everyone = Medium(plan_of(scenario("radio.target_snr_db=77.5"))), list(range(UAVS))
    near, apart = line(*everyone), line(0.0, 1.0, 2.0, 130.0, 131.0, 400.0)
    sent, outages, spent, airtime = np.zeros((UAVS, UAVS), int), np.zeros((UAVS, UAVS), int), 0, 0.0
    ticks = [(near, everyone), (near, everyone), (apart, everyone), (near, [0, 2, 5]), (apart, [0, 2, 5])] * 4
    for tick, (states, speakers) in enumerate(ticks):
        along = states[:, 0]
        records = medium.send(tick, [frames(FrameKind.STATE, speakers, 4)], states)
        assert records[:, 1:3].tolist() == [
            [source, target]
            for source in speakers
            for target in everyone
            if 0 < abs(along[source] - along[target]) < 100
        ]
        assert (records[:, 0] == tick).all()
        through = {(source, target) for _, source, target, _, _, delivered, _ in records.tolist() if delivered}
        assert links_of(medium.due(tick + 1)) == through
        for _, source, target, _, slots, delivered, _ in records.tolist():
            sent[source, target] += 1
            outages[source, target] += not delivered
            spent += slots
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
        stored = state_of(meter)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 16 * 2**20
    times = np.isin(senders, senders[::2]) * 2 + 2 + (senders < senders[5]) * 2
    assert stored["table"].tolist() == [[s, leader, n, n * (s == 2)] for s, n in zip(senders, times, strict=True)]
    again = Meter(scenario().radio, uavs)
    restore(again, stored)
    again.count(FrameKind.UPLOAD, 1, links, np.ones(5, dtype=int), np.ones(5, dtype=bool), None)
    assert again.links()[0] == [0, leader, 7, 0]


# -- channels as plug-ins ------------------------------------------------------------------------------------------


class Disk(Channel):
    """Everything gets through within a radius, in one slot; beyond it nothing does, in two."""

    name = "disk"

    def transmit(self, distance_m: Any, bits: int, rng: np.random.Generator) -> tuple[Any, Any]:
        near = distance_m <= 2.5
        return np.where(near, 1, 2), near


def test_a_channel_of_a_user_carries_frames_without_a_closed_form() -> None:
    plugins.register(Disk)
    medium = Medium(plan_of(scenario("uavs=5", "radio.model=disk")))
    records = medium.send(3, [frames(FrameKind.STATE, list(range(5)), 4)], line(0, 2, 4, 6, 50))
    (batch,) = medium.due(4)
    near = [(0, 1), (1, 0), (1, 2), (2, 1), (2, 3), (3, 2)]
    assert [(int(s), int(t)) for s, t in batch.links] == near
    assert [(int(s), int(t)) for _, s, t, _, _, through, _ in records if through] == near
    assert set(records[:, 4].tolist()) == {1, 2}
    total = medium.meter.traffic[FrameKind.STATE]
    assert (total.sent, total.delivered, total.slots, total.delivered_slots) == (20, 6, 6 + 2 * 14, 6)
    assert (total.expected_outages, total.expected_delivered_slots) == (None, None)
    again = Medium(plan_of(scenario("uavs=5", "radio.model=disk")))
    restore(again, state_of(medium))
    assert again.meter.traffic == medium.meter.traffic


BITS = {
    "zero": 0.0,
    "negative": -1.0,
    "nan": math.nan,
    "inf": math.inf,
    "none": None,
    "text": "9",
    "fails": lambda _: [].pop(),
}


@pytest.mark.parametrize("bits", BITS.values(), ids=BITS)
def test_a_channel_whose_slots_carry_no_number_of_bits_is_refused_where_the_plan_is_made(bits: Any) -> None:
    rate = property(bits if callable(bits) else lambda _: bits)
    plugins.register(type("Mute", (Disk,), {"name": "mute", "bits_per_slot": rate}))
    flown = scenario("radio.model=mute", method="mfgfl-hf")
    with pytest.raises(BadInput, match=r"channel 'mute': `bits_per_slot` (is .*; return a finite|failed: )"):
        plan_of(flown)
    with pytest.raises(ConformanceError, match="Mute: channel 'mute': `bits_per_slot`"):
        check_channel(plugins.load("channel", "mute"))


class Turns(Channel):
    """Sends one transmission after another, a slot each, and says of each link what it foresees."""

    name = "turns"
    seen: ClassVar[list[Message]] = []

    def carry(self, memory: Any, message: Message, rng: np.random.Generator) -> Any:
        assert message.first is not None
        self.seen.append(message)
        turn = np.searchsorted(message.first, np.arange(len(message.source)), side="right") - 1
        one = np.ones(len(turn), dtype=np.int64)
        return memory, one, message.target != 2, turn

    def foreseen(self, memory: Any, message: Message) -> Any:
        lost = (message.target == 2).astype(float)
        return lost, 1.0 - lost


def test_a_frame_that_waits_arrives_later_and_is_no_longer_on_the_air() -> None:
    plugins.register(Turns)
    Turns.seen.clear()
    flown = scenario("uavs=4", "radio.model=turns", "radio.coherence_time_s=0.05", "dt=0.1", "start.height=50")
    medium, states = Medium(plan_of(flown)), line(0, 2, 4, 90)
    records = medium.send(3, [frames(FrameKind.STATE, list(range(4)), 4)], states)
    assert records[:, LinkColumn.SLOTS].tolist() == [1] * 12
    assert records[:, LinkColumn.WAITED].tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert {source for source, _ in links_of(medium.due(4))} == {0, 1}  # after one slot, and after two
    assert {source for source, _ in links_of(medium.due(5))} == {2, 3}
    total = medium.meter.traffic[FrameKind.STATE]
    assert (total.slots, total.outages, total.expected_outages) == (12, 3, 3.0)
    assert total.airtime_s == pytest.approx(4 * 0.05)
    (message,) = Turns.seen
    assert message.kind == "state"
    assert message.first is not None
    assert message.first.tolist() == [0, 3, 6, 9]
    assert message.place_m is not None
    assert message.place_m.tolist() == [[x, 0, 50] for x in (0, 2, 4, 90)]


@pytest.mark.parametrize(("model", "unknown"), [("disk", True), ("ideal", False), ("rice", False)])
def test_a_summary_has_the_closed_forms_there_are(model: str, unknown: bool) -> None:
    plugins.register(Disk)
    radio = Engine(scenario(f"radio.model={model}", "duration=2", method="hjb"), "forms").complete()["radio"]
    assert radio["sent"] > 0
    for name in ("outage_rate_theory", "latency_slots_mean_theory"):
        assert (radio[name] is None) == (radio["traffic"]["state"][name] is None) == unknown
    if model == "ideal":
        assert (radio["outages"], radio["outage_rate_theory"]) == (0, 0.0)
        assert radio["latency_slots_mean"] == radio["latency_slots_mean_theory"] == 1.0


def test_both_directions_and_all_fragments_of_a_pair_share_its_memory() -> None:
    channel = Bursts(Bursts.Options(), Scenario())
    ends, memory, rng = np.array([[0, 0, 1, 1], [1, 1, 0, 0]]), channel.init(2), np.random.default_rng(3)
    message = Message(0, 128, *ends, np.full(4, 50.0), np.zeros((2, 2)))
    bad = []
    for _ in range(2000):
        memory, _, arrives = channel.carry(memory, message, rng)
        assert len(set(arrives.tolist())) == 1
        bad.append(memory["bad"][0, 1] and not arrives[0])
    assert np.mean(bad) == pytest.approx(0.05 / 0.25, abs=0.05)


def test_a_flight_over_a_channel_with_a_memory_is_the_same_in_nodes_and_after_a_resume(tmp_path: Path) -> None:
    plugins.register(Bursts)
    flown = load(None, ["uavs=5", "radio.model=bursts", "duration=30"], method="vasarhelyi")
    whole = Engine(flown, "whole").complete()
    assert whole["radio"]["outages"] > 0
    assert steady(Engine(flown, "nodes", uavs_per_node=1).complete()) == steady(whole)
    folder = dead(tmp_path, flown, 287, rows=2)
    assert resumed(folder, "--uavs-per-process", "4")["trajectory_sha256"] == whole["trajectory_sha256"]
