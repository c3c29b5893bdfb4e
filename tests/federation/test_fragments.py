"""Long models in fragments: their size and bill, what is averaged of those that arrived, and what UAVs fill in."""

import math
import re
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.federation.codec import Codec, Cut
from meanflock.federation.cut import coding_of, longest
from meanflock.federation.inbox import Round
from meanflock.federation.memory import GlobalModels, OwnModels
from meanflock.federation.plan import plan_of
from meanflock.federation.rules.fedavg import FedAvg
from meanflock.federation.rules.robust import Median
from meanflock.launch.engine import Engine
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames
from tests.federation.plugins import Long
from tests.telemetry import fly

LENGTH = 100_000


@pytest.fixture(autouse=True)
def _registered() -> None:
    mf.register(Long)


def flown(*keys: str, uavs: int = 6, length: int = 3600, duration: float = 10.5) -> Scenario:
    fixed = [f"uavs={uavs}", f"controller.length={length}", f"duration={duration}", 'stop="duration"']
    return load(None, [*fixed, "federation.fraction=1.0", *keys], method="long", seed=7)


def test_a_fragment_has_room_for_its_number_and_costs_every_bit_of_it() -> None:
    case = flown(length=LENGTH, uavs=25)
    cut = plan_of(case).hops[0].codec.cut
    assert cut.slots == longest(case) == 3  # 97 % of them arrive; of those of 4 slots 90 %
    room = int(cut.slots * case.radio.bits_per_slot / 8)
    width = plan_of(case).hops[0].codec.width
    assert room - 4 < width <= room
    assert cut.size == (room - 4) // 4
    assert cut.per_tick == 250  # ⌊0.1 s / (8 · 50 µs)⌋
    engine = Engine(case, "bill")
    bill = engine.complete()["radio"]["traffic"]
    fragments = 5 * 25 * math.ceil(LENGTH / cut.size)
    assert bill["uplink"]["transmissions"] == fragments - 5 * math.ceil(LENGTH / cut.size)  # the leader's own are free
    assert bill["uplink"]["payload_bits"] == 8 * width * bill["uplink"]["transmissions"]
    assert abs(bill["uplink"]["outage_rate"] - bill["uplink"]["outage_rate_theory"]) < 0.005
    after = [hop.after for hop in plan_of(case).hops]
    assert after == [0, 2]
    assert after[1] + plan_of(case).hops[1].codec.ticks - 1 + case.hop_ticks <= 6  # ticks of a round


@pytest.mark.parametrize("topology", ["topology=leader", "clusters=2", "topology=neighbours"])
@pytest.mark.parametrize("by_samples", [False, True])
def test_without_losses_a_round_in_fragments_is_the_mean(topology: str, by_samples: bool) -> None:
    sure = ("controller.decay=1.0", "radio.rice_xi=1e4", "radio.bits_per_float=64", "duration=2.6")
    weighted = f"controller.by_samples={by_samples}".lower()
    case = flown(f"federation.{topology}", "federation.fragment=4", weighted, *sure)
    assert plan_of(case).hops[0].codec.count > 3
    engine = Engine(case, "mean")
    assert engine.complete()["radio"]["traffic"]["uplink"]["outages"] == 0
    start = Long(Long.Options(length=3600), case).init(np.arange(6), np.zeros((6, 4)))
    mean = np.average(start["model"], axis=0, weights=start["samples"] if by_samples else None)
    np.testing.assert_allclose(engine.crew.agents[0]._memory["model"], np.tile(mean, (6, 1)), rtol=1e-12, atol=1e-12)


def test_a_uav_fills_what_it_missed_from_the_last_global_model_and_not_from_its_own() -> None:
    codec = codec_of(4)
    kept = GlobalModels(codec, 2, gathers=True)

    class Learner:
        models = np.full((2, 4), 9.0)

        def models_to_send(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            return rows, self.models[rows], np.ones(len(rows))

        def take(self, rows: np.ndarray, models: np.ndarray, number: int, whole: np.ndarray, notes: Any) -> None:
            self.models[rows] = models
            assert number == 1
            self.whole = whole.tolist()

        def silent(self) -> np.ndarray:
            return np.zeros(2, dtype=bool)

    def arrive(model: list[float], *links: tuple[int, int]) -> None:
        sent, row = np.array(links).T
        kept.add(sent, row, codec.read(rows_of(codec, [model])), 1, learner)

    learner = Learner()
    arrive([1.0, 2.0, 3.0, 4.0], (0, 0), (1, 0), (0, 1))
    kept.take(1, learner)
    assert learner.whole == [True, False]
    assert learner.models.tolist() == [[1, 2, 3, 4], [1, 2, 9, 9]]  # the second never had a global one to fill from
    learner.models[:] = 7.0
    arrive([5.0, 6.0, 7.0, 8.0], (0, 0))
    kept.take(1, learner)
    assert learner.models.tolist() == [[5, 6, 3, 4], [7, 7, 7, 7]]


PAIRS = Cut(1, 2, 9)


def codec_of(length: int, cut: Cut | None = PAIRS) -> Codec:
    return Codec(coding_of(Scenario(), "float64"), (length,), cut)


def rows_of(codec: Codec, models: list[list[float]]) -> np.ndarray:
    return codec.rows(codec.encode(np.array(models), np.arange(len(models)), 1), np.ones((len(models), 1)))


def mail_of(models: list[list[float]], lost: set[tuple[int, int]], to: int = 9) -> Round:
    """A round of models in fragments of two weights, without the fragments `lost`: (sender, number)."""
    codec = codec_of(len(models[0]))
    rows = rows_of(codec, models)
    source = np.arange(len(models), dtype=np.int32).repeat(codec.count)
    number = np.tile(np.arange(codec.count), len(models))
    links = [[row, to] for row in range(len(rows)) if (source[row], number[row]) not in lost]
    mail = Round(0, codec, np.array([to]))
    mail.add(Frames(FrameKind.UPLOAD, 1, source, rows, np.array(links, dtype=np.int32)))
    return mail.take(1, late=False)


def test_each_fragment_is_averaged_over_the_uavs_whose_copy_arrived() -> None:
    round_ = mail_of([[1, 1, 1, 1], [3, 3, 3, 3], [8, 8, 8, 8]], lost={(2, 0), (0, 1), (1, 1), (2, 1)})
    uploads = round_.uploads(0)
    assert uploads.arrived.tolist() == [[True, True, False, False], [True, True, False, False]]
    assert uploads.uavs.tolist() == [0, 1]  # nothing arrived of the third
    assert uploads.models[:, 2:].tolist() == [[0, 0], [0, 0]]
    assert round_.means(np.array([0]), np.ones(3)).tolist() == [[2, 2, 0, 0]]
    case = flown()
    _, model = FedAvg(FedAvg.Options(), case).step({}, uploads)
    assert model.tolist() == [2, 2, 0, 0]
    _, middle = Median(Median.Options(), case).step({}, mail_of([[1, 1], [3, 3], [9, 9]], lost={(1, 0)}).uploads(0))
    assert middle.tolist() == [5, 5]
    round_ = mail_of([[1, 1, 1, 1], [0, 0, 0, 0], [4, 4, 4, 4]], lost={(1, 0), (1, 1), (2, 1)}, to=1)
    round_.own = OwnModels(codec_of(4), 1)
    round_.own.models[:] = 7.0
    uploads = round_.uploads(0)
    assert uploads.uavs.tolist() == [0, 1, 2]
    assert FedAvg(FedAvg.Options(), case).step({}, uploads)[1].tolist() == [4, 4, 4, 4]
    assert round_.means(np.array([0]), np.ones(3), np.ones(1)).tolist() == [[4, 4, 4, 4]]


def test_of_late_uploads_the_latest_of_each_uav_counts_in_the_order_of_the_uavs() -> None:
    mail = Round(0, codec_of(1, None), np.array([9]))
    for number, uavs, models in ((1, [3, 5], [[1.0], [2.0]]), (2, [2, 5], [[7.0], [8.0]])):
        links = np.array([[0, 9], [1, 9]], dtype=np.int32)
        mail.add(Frames(FrameKind.UPLOAD, number, np.array(uavs, np.int32), np.array(models), links))
    uploads = mail.take(2, late=True).uploads(0)
    assert (uploads.uavs.tolist(), uploads.sent.tolist()) == ([2, 3, 5], [2, 1, 2])
    assert uploads.models[:, 0].tolist() == [7.0, 1.0, 8.0]


def test_of_a_late_upload_fragments_count_that_no_later_one_brought() -> None:
    codec, mail = codec_of(4), Round(0, codec_of(4), np.array([9]))
    for number, model, links in ((1, [1.0, 2.0, 3.0, 4.0], [[0, 9], [1, 9]]), (2, [5.0, 6.0, 7.0, 8.0], [[1, 9]])):
        ends = np.array(links, dtype=np.int32)
        mail.add(Frames(FrameKind.UPLOAD, number, np.zeros(2, np.int32), rows_of(codec, [model]), ends))
    uploads = mail.take(2, late=True).uploads(0)
    assert (uploads.uavs.tolist(), uploads.sent.tolist()) == ([0], [2])
    assert uploads.models.tolist() == [[1, 2, 7, 8]]


def test_a_fragment_that_nobody_delivered_is_not_broadcast() -> None:
    case = flown("federation.fragment=6", "duration=2.6", uavs=2)  # most are lost
    summary, sink = fly(case)
    bill = summary["radio"]["traffic"]
    assert any(
        f"{bill['uplink']['delivered']} of {plan_of(case).hops[0].codec.count} fragments arrived" in text
        for text in sink.texts
    )
    assert 0 < bill["uplink"]["delivered"] < plan_of(case).hops[0].codec.count
    assert bill["broadcast"]["transmissions"] == bill["uplink"]["delivered"]
    (text,) = [text for text in sink.texts if "of the global model were received" in text]
    _, sent, whole, part, nothing = map(int, re.findall(r"\d+", text))
    assert sent == bill["broadcast"]["transmissions"]
    assert (whole, part, nothing) == (0, 1, 0)
    assert 0 < bill["broadcast"]["delivered"] < sent


def test_models_are_whole_where_fragments_would_not_help_and_nodes_are_told_the_size_of_fragments() -> None:
    for whole in (flown("federation.fragment=0"), flown("radio.model=ideal"), flown(length=300)):
        assert plan_of(whole).hops[0].codec.cut is None
        assert plan_of(whole).node_scenario.federation.fragment == 0
    assert plan_of(flown("federation.fragment=2", length=300)).hops[0].codec.count == 2
    told = plan_of(flown()).node_scenario
    assert told.federation.fragment == 3
    assert plan_of(told).hops[0].codec.cut == plan_of(flown()).hops[0].codec.cut


def test_in_space_models_are_cut_where_more_than_half_would_be_lost() -> None:
    def pieces(*settings: str) -> int:
        return plan_of(load(None, [*settings], method="mfgfl-hf")).hops[0].codec.count

    assert pieces("space.dimensions=3") == 3  # 580 floats take 8 of 8 slots
    assert pieces("space.dimensions=3", "radio.target_snr_db=70") == 1
    assert pieces("space.dimensions=3", "federation.fragment=0") == 1
    assert pieces("radio.target_snr_db=80") == 1  # in the plane their length decides
