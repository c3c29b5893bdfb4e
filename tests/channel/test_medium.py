"""The medium: the targets of each kind of frame, and the tick in which a frame is delivered."""

import math

import numpy as np
import pytest

from meanflock.channel.medium import Medium
from meanflock.federation.schedule import Schedule
from meanflock.swarm.wire.messages import FrameKind
from tests.channel.frames import UAVS, frames, line, links_of, scenario


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
    assert free.expected_outages is not None
    assert bill.expected_outages is not None
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


def test_two_kinds_of_frames_of_one_sender_have_links_of_their_own() -> None:
    medium, sent = Medium(scenario()), [frames(FrameKind.UPLOAD, [1], 246, 1), frames(FrameKind.STATE, [1], 4)]
    records = medium.send(5, sent, line(*range(UAVS)))
    found = [(kind, target) for _, _, target, kind, _ in records.tolist()]
    assert found == [(FrameKind.UPLOAD, 0), *((FrameKind.STATE, target) for target in (0, 2, 3, 4, 5))]


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
