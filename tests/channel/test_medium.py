"""The medium: which links carry a frame, when it is delivered, what it costs, and that nobody's order matters."""

import math
from typing import Any

import numpy as np
import pytest

from meanflock.channel.medium import Medium
from meanflock.channel.meter import Meter
from meanflock.groundstation.engine import Engine
from meanflock.swarm import state
from meanflock.swarm.rounds import Rounds
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.swarm.wire.messages import FrameKind, Frames
from tests.methods import FEDERATED, METHODS, PARTS

UAVS = 6
TICKS = 240
PERIOD = 50


def scenario(*settings: str, **options: Any) -> Scenario:
    return load(None, [f"uavs={UAVS}", *settings], **options)


def line(*metres: float) -> state.States:
    """UAVs at rest along x."""
    states = np.zeros((len(metres), state.SIZE))
    states[:, state.X] = metres
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


# -- who hears whom -----------------------------------------------------------------------------------------------


def test_an_upload_goes_to_the_leader_a_global_model_to_everyone_a_state_to_those_in_range() -> None:
    medium = Medium(scenario("federation.leader=2", "radio.target_snr_db=60"))
    states = line(0.0, 99.9, 100.0, 100.1, 200.0, 1e6)
    records = medium.send(
        5,
        [
            frames(FrameKind.STATE, [0, 4], 4),
            frames(FrameKind.GLOBAL, [2], 246, 1),
            frames(FrameKind.UPLOAD, [0, 2, 5], 246, 1),
        ],
        states,
    )
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


def test_with_clusters_an_upload_goes_to_the_head_and_a_relay_to_the_leader() -> None:
    """Clusters {0 1 2} and {3 4 5}; UAV 4 leads, so it heads the second."""
    medium = Medium(
        scenario("federation.leader=4", "federation.clusters=2", "radio.target_snr_db=60", method="mfgfl-hf")
    )
    states = line(0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
    uploads = medium.send(5, [frames(FrameKind.UPLOAD, [0, 1, 3, 4, 5], 246, 1)], states)
    assert {(int(s), int(t)) for _, s, t, _, _ in uploads} == {(1, 0), (3, 4), (5, 4)}
    assert links_of(medium.due(6)) == {(0, 0), (1, 0), (3, 4), (4, 4), (5, 4)}
    relays = medium.send(6, [frames(FrameKind.RELAY, [0, 4], 247, 1)], states)
    assert {(int(s), int(t)) for _, s, t, _, _ in relays} == {(0, 4)}
    assert links_of(medium.due(7)) == {(0, 4), (4, 4)}
    totals = medium.meter.traffic
    assert totals[FrameKind.UPLOAD].payload_bits == 3 * 246 * 32
    assert totals[FrameKind.RELAY].payload_bits == 247 * 32
    assert medium.meter.links() == [[0, 4, 1, 0], [1, 0, 1, 0], [3, 4, 1, 0], [5, 4, 1, 0]]


def test_what_is_delivered_is_what_was_sent() -> None:
    medium = Medium(scenario("radio.target_snr_db=60"))
    sent = frames(FrameKind.UPLOAD, [1, 3, 4], 108, 9)
    medium.send(0, [sent], line(*range(UAVS)))
    (batch,) = medium.due(1)
    assert (batch.kind, batch.round) == (FrameKind.UPLOAD, 9)
    for row, (source, _) in zip((0, 1, 2), sorted(links_of([batch])), strict=True):
        where = batch.source.tolist().index(source)
        np.testing.assert_array_equal(batch.payload[where], sent.payload[row])


def test_a_swarm_of_one_pays_for_its_broadcast_and_nobody_hears_it() -> None:
    medium = Medium(load(None, ["uavs=1"]))
    records = medium.send(0, [frames(FrameKind.STATE, [0], 4)], line(0.0))
    assert records.shape == (0, 5)
    assert medium.due(1) == []
    assert medium.meter.traffic[FrameKind.STATE].payload_bits == 128
    assert medium.meter.traffic[FrameKind.STATE].sent == 0


# -- when ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dt", "theta", "slots"), [(0.1, 5e-5, 8), (0.125, 0.125, 8), (0.125, 0.1875, 12), (0.125, 1.0, 5)]
)
def test_a_frame_is_delivered_after_its_slots_at_least_a_tick_later_once_or_never(
    dt: float, theta: float, slots: int
) -> None:
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
    for tick in range(400 + math.ceil(slots * theta / dt) + 2):
        found = {(batch.round, *link) for batch in medium.due(tick) for link in links_of([batch])}
        assert found == expected.get(tick, set())


@pytest.mark.parametrize(
    ("dt", "theta", "slots"), [(0.1, 5e-5, 8), (0.125, 0.1875, 12), (0.03, 0.01, 9), (0.03, 0.02, 15)]
)
def test_an_upload_that_takes_every_slot_it_may_is_there_when_its_round_closes(
    dt: float, theta: float, slots: int
) -> None:
    flown = scenario(
        f"dt={dt}",
        f"radio.coherence_time_s={theta}",
        f"radio.latency_threshold_slots={slots}",
        "radio.target_snr_db=-10",
        f"radio.bandwidth_hz={246 * 32 / theta / math.log2(1.1) / (slots - 0.5)}",
        "radio.noise_psd_dbm_hz=-200",
    )
    medium, rounds = Medium(flown), Rounds(flown)
    tick = flown.period_ticks
    records = medium.send(tick, [frames(FrameKind.UPLOAD, [1], 246, rounds.opens(tick))], line(*range(UAVS)))
    assert records[:, 4].tolist() == [slots]
    closing = next(t for t in range(tick, tick + 1000) if rounds.closes(t))
    arriving = next(t for t in range(tick, tick + 1000) if medium.due(t))
    assert arriving <= closing


# -- what it costs ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def totals() -> dict[str, dict[str, Any]]:
    """The summaries of a whole short flight of every method."""
    flights = {}
    for method in METHODS:
        flown = scenario(f"method={method}", f"duration={TICKS / 10}", 'stop="duration"', f"federation.period={PERIOD}")
        engine = Engine(flown, f"bill-{method}")
        assert sum(1 for _ in engine.fly()) == TICKS
        flights[method] = engine.world.finish()
    return flights


@pytest.mark.parametrize("method", METHODS)
def test_a_transmission_costs_its_floats_and_the_bill_is_their_count(
    method: str, totals: dict[str, dict[str, Any]]
) -> None:
    summary = totals[method]
    traffic, bits = summary["radio"]["traffic"], summary["payload_bits"]
    flown = scenario(f"method={method}", f"federation.period={PERIOD}")
    rounds = range(1, (TICKS - 1) // PERIOD + 1) if method in FEDERATED else range(0)
    leader = flown.federation.leader
    uploads = sum(int((Rounds(flown).participants(k) != leader).sum()) for k in rounds)
    model_bits = sum(PARTS.get(method, ())) * 32
    states = UAVS * TICKS if method == "hjb" else UAVS  # the mission plan is the first, then every tick

    assert summary["rounds"] == len(rounds)
    assert traffic["uplink"]["transmissions"] == uploads
    assert traffic["broadcast"]["transmissions"] == len(rounds)
    assert traffic["state"]["transmissions"] == states
    assert bits == {
        "uplink": uploads * model_bits,
        "relay": 0,
        "broadcast": len(rounds) * model_bits,
        "state": states * 4 * 32,
        "total": (uploads + len(rounds)) * model_bits + states * 128,
    }
    assert traffic["uplink"]["sent"] == uploads
    assert traffic["broadcast"]["sent"] == len(rounds) * (UAVS - 1)
    assert traffic["state"]["sent"] == (UAVS * (UAVS - 1) * (TICKS - 1) if method == "hjb" else 0)


@pytest.mark.parametrize("method", METHODS)
def test_every_copy_is_delivered_or_in_outage_and_the_wire_carries_at_least_the_payload(
    method: str, totals: dict[str, dict[str, Any]]
) -> None:
    for name, bill in totals[method]["radio"]["traffic"].items():
        assert bill["sent"] == bill["delivered"] + bill["outages"]
        on_air = bill["payload_bits"] - (UAVS * 128 if name == "state" else 0)  # the plan came with the Welcome
        assert bill["wire_bytes"] * 8 >= on_air
        assert (bill["airtime_s"] > 0) == (on_air > 0)


def test_the_leader_s_own_upload_costs_nothing() -> None:
    medium = Medium(scenario("federation.leader=3"))
    records = medium.send(1, [frames(FrameKind.UPLOAD, [3], 246)], line(*range(UAVS)))
    bill = medium.meter.traffic[FrameKind.UPLOAD]
    assert records.shape == (0, 5)
    assert (bill.transmissions, bill.payload_bits, bill.sent, bill.slots, bill.airtime_s) == (0, 0, 0, 0, 0.0)
    assert links_of(medium.due(2)) == {(3, 3)}


@pytest.mark.parametrize("bits", [16, 32, 64])
def test_a_float_is_as_wide_as_the_scenario_says(bits: int) -> None:
    medium = Medium(scenario(f"radio.bits_per_float={bits}"))
    sent = [frames(FrameKind.UPLOAD, [1, 2], 108), frames(FrameKind.STATE, [0], 4)]
    as_wide = [Frames(batch.kind, 0, batch.source, batch.payload.astype(FLOAT_OF_BITS[bits])) for batch in sent]
    medium.send(1, as_wide, line(*range(UAVS)))
    assert medium.meter.traffic[FrameKind.UPLOAD].payload_bits == 2 * 108 * bits
    assert medium.meter.traffic[FrameKind.STATE].payload_bits == 4 * bits


def test_a_row_of_figures_is_of_the_bill_as_it_is_now() -> None:
    medium, states = (
        Medium(scenario("method=mfgfl-hf", "federation.clusters=2", "radio.target_snr_db=77")),
        line(*range(UAVS)),
    )
    medium.meter.initial(128)
    kinds = [FrameKind.UPLOAD, FrameKind.STATE, FrameKind.GLOBAL, FrameKind.RELAY, FrameKind.STATE]
    for tick, kind in enumerate(kinds):
        medium.send(tick, [frames(kind, [tick % 3 + 1], 4 + tick)], states)
        bills = [
            medium.meter.traffic[of] for of in (FrameKind.UPLOAD, FrameKind.RELAY, FrameKind.GLOBAL, FrameKind.STATE)
        ]
        totals = [sum(getattr(bill, name) for bill in bills) for name in ("delivered", "outages", "airtime_s")]
        assert medium.meter.figures() == pytest.approx((*(bill.payload_bits for bill in bills), *totals))
        again = Meter(medium.meter.radio, UAVS)
        again.restore(medium.meter.snapshot())
        assert again.figures() == medium.meter.figures() == medium.meter.figures()
    assert len({*medium.meter.figures()[:4]}) == 4


def test_airtime_lasts_until_the_last_link_is_served_or_given_up() -> None:
    medium = Medium(scenario("radio.target_snr_db=76"))
    records = medium.send(1, [frames(FrameKind.GLOBAL, [0], 246)], line(*range(UAVS)))
    assert medium.meter.traffic[FrameKind.GLOBAL].airtime_s == pytest.approx(np.abs(records[:, 4]).max() * 5e-5)
    assert medium.meter.traffic[FrameKind.GLOBAL].slots == np.abs(records[:, 4]).sum()
    assert sorted(map(tuple, medium.meter.links())) == [
        (0, int(target), 1, int(slots < 0)) for _, _, target, _, slots in records
    ]


def test_whoever_speaks_and_is_in_range_the_bill_is_that_of_the_links_that_were_used() -> None:
    """Speakers fall silent, UAVs leave the range and come back: no tick may go by the links of the one before."""
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


# -- nobody's order matters ---------------------------------------------------------------------------------------


def test_the_order_in_which_kinds_are_handed_over_does_not_matter() -> None:
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


class Shuffled:
    """Holds back what the world asks until it waits, then passes it on in another order every tick."""

    def __init__(self, engine: Engine) -> None:
        self._bus = engine.world._bus
        self._put, self._held = self._bus.put, []
        self._draw = np.random.default_rng(8)
        self._bus.put, self._bus.receive = self.put, self.receive  # type: ignore[method-assign]

    def put(self, key: str, payload: bytes) -> None:
        if key.endswith("/sense"):
            self._held.append((key, payload))
        else:
            self._put(key, payload)

    def receive(self, _timeout_s: float) -> None:
        for k in self._draw.permutation(len(self._held)):
            self._put(*self._held[k])
        self._held.clear()


@pytest.mark.parametrize("method", ["hjb", "mfgfl-hf"])
def test_the_order_in_which_nodes_answer_does_not_matter(method: str) -> None:
    flown = scenario(f"method={method}", "duration=9", "federation.period=20", "radio.target_snr_db=76")
    summaries = []
    for shuffled in (False, True):
        engine = Engine(flown, "order", uavs_per_node=1)
        if shuffled:
            Shuffled(engine)
        for _ in engine.fly():
            pass
        summaries.append(engine.world.finish())
    for volatile in ("wall_time_s", "real_time_factor"):
        assert {summary.pop(volatile) is None for summary in summaries} == {False}
    assert summaries[0]["radio"]["outages"] > 0
    assert summaries[0] == summaries[1]
