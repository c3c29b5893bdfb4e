"""Codings of models: bounds of rounding, rejected payloads, what rounding takes; fragments of long models."""

import math
import re
import struct
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import meanflock as mf
from meanflock.agent.node import Agent
from meanflock.federation.coding import COARSEST, FINEST, STEPS, Coding, Counted
from meanflock.federation.fragments import Cut, longest
from meanflock.federation.mail import Joined, Mail, OwnModel
from meanflock.federation.memory import Feedback, GlobalModels
from meanflock.federation.plan import plan_of
from meanflock.federation.rules.fedavg import FedAvg
from meanflock.federation.rules.robust import Median
from meanflock.launch.engine import Engine
from meanflock.net import tick as wire
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from tests.agent import nodes
from tests.federation.plugins import Long
from tests.methods import FEDERATED, PARTS
from tests.telemetry import fly

QUICK = settings(max_examples=100, deadline=None, database=None)
H, HF = PARTS["mfgfl-h"], PARTS["mfgfl-hf"]


@st.composite
def drawn(draw: st.DrawFn, method: str = "mfgfl-hf", largest: float = 1e29) -> np.ndarray:
    """A few models of random weights over any range of magnitudes, some weights chosen with malice."""
    weights = sum(PARTS[method])
    dice = np.random.default_rng(draw(st.integers(0, 2**32)))
    powers = draw(st.tuples(*[st.floats(-324, np.log10(largest))] * 2))
    low, high = sorted(power + 0.0 for power in powers)  # from 0 to −0, NumPy says, is an interval of negative length
    table: np.ndarray = dice.uniform(-1, 1, (draw(st.integers(1, 3)), weights))
    table *= 10.0 ** dice.uniform(low, high, table.shape)
    chosen = st.tuples(st.integers(0, len(table) - 1), st.integers(0, weights - 1), st.floats(-largest, largest))
    for row, weight, value in draw(st.lists(chosen, max_size=6)):
        table[row, weight] = value
    return table


def scales_of(coded: np.ndarray, method: str) -> list[tuple[float, ...]]:
    """The scales, read with `struct` alone."""
    count, weights = len(PARTS[method]), sum(PARTS[method])
    return [struct.unpack_from(f"<{count}f", row.tobytes(), weights) for row in coded]


@pytest.mark.parametrize("method", FEDERATED)
def test_a_weight_is_off_by_at_most_half_a_step_of_its_part(method: str) -> None:
    coding = Coding("int8", PARTS[method])
    ends = np.cumsum(PARTS[method])

    @QUICK
    @given(drawn(method))
    def check(meant: np.ndarray) -> None:
        coded = coding.encode(meant)
        assert coding.valid(coded).all()
        off = np.abs(coding.decode(coded) - meant)
        for row, scales in enumerate(scales_of(coded, method)):
            for end, size, scale in zip(ends, PARTS[method], scales, strict=True):
                part = slice(end - size, end)
                assert off[row, part].max() <= scale * 0.5 * (1 + 1e-12)
                largest = np.abs(meant[row, part]).max()
                assert FINEST <= scale <= max(FINEST, largest / STEPS * (1 + 2**-23))  # no coarser than need be

    check()


@pytest.mark.parametrize("name", ["int8", "float16", "float32"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_a_weight_that_cannot_be_written_makes_its_own_row_unsound_and_no_other(name: str, bad: float) -> None:
    coding = Coding(name, H)
    meant = np.ones((3, 108))
    meant[1, 7] = bad
    coded = coding.encode(meant)
    assert coding.valid(coded).tolist() == [True, False, True]
    with pytest.raises(MessageRejected) as caught:
        receive(coding, coded)
    assert caught.value.reason == "non-finite"


def receive(coding: Coding, payload: np.ndarray) -> None:
    """What the world does with payloads: the reader of the message looks at floats, the coding at bytes."""
    uavs = np.arange(len(payload), dtype=np.int32)
    raw = wire.write_act(Act(1, 1, np.zeros((len(uavs), 2)), outbox=(Frames(FrameKind.UPLOAD, 1, uavs, payload),)))
    for frames in wire.read_act(raw).outbox:
        coding.check(frames.source, frames.payload)


BOUNDS = [np.nan, np.inf, -np.inf, -1.0, 0.0, 1e-45, FINEST / 2, FINEST, COARSEST / 2, float(np.float32(3e38))]
SCALES = st.sampled_from(BOUNDS) | st.floats(width=32)


@QUICK
@given(st.binary(min_size=108, max_size=108), SCALES, SCALES)
def test_a_payload_is_steps_times_scales_and_is_rejected_if_one_is_beyond_its_bounds(
    steps: bytes, first: float, second: float
) -> None:
    coding, raw = Coding("int8", H), steps + struct.pack("<2f", first, second)
    row, scales = np.frombuffer(raw, "u1")[None], np.array(struct.unpack_from("<2f", raw, 108))
    if ((scales >= FINEST) & (scales <= np.float32(COARSEST))).all() and 0x80 not in steps:
        coding.check(np.arange(1), row)
        np.testing.assert_array_equal(coding.decode(row)[0], np.frombuffer(steps, "i1") * scales.repeat(H))
    else:
        with pytest.raises(MessageRejected, match=r"^non-finite"):
            coding.check(np.arange(1), row)


RESIDUALS = "meanflock.residuals"  # in a checkpoint


def uploads(agent: Agent, until: int) -> list[tuple[np.ndarray, Frames]]:
    """What an agent learned by each round's tick, and what it sent then."""
    sent, seen = [], agent.act(nodes.sense(0)).models
    for tick in range(1, until):
        act = agent.act(nodes.sense(tick))
        sent += [(seen, batch) for batch in act.outbox if batch.kind == FrameKind.UPLOAD]
        seen = act.models
    return sent


@pytest.mark.parametrize("name", ["int8", "float16"])
def test_an_agent_s_uploads_add_up_to_its_models_but_for_the_residual_of_its_checkpoint(name: str) -> None:
    case = nodes.flown(f"federation.payload={name}", "federation.fraction=0.7")
    agent, coding = Agent(nodes.welcome(case)), Coding(name, HF)
    heard, sent, meant = uploads(agent, 36), np.zeros((3, 246)), np.zeros((3, 246))
    assert len({len(batch.source) for _, batch in heard}) > 1
    for seen, batch in heard:
        rows = np.searchsorted(nodes.UAVS, batch.source)
        sent[rows] += coding.decode(batch.payload)
        meant[rows] += seen[rows]
    residuals = nodes.kept(agent, 36)[RESIDUALS]
    assert np.abs(residuals).max() > 0
    np.testing.assert_allclose(sent + residuals, meant, rtol=0, atol=1e-12)
    past = nodes.kept(agent, 37) | {RESIDUALS: residuals[:, :-1]}
    with pytest.raises(BadInput, match="residuals"):
        Agent(msgspec.structs.replace(nodes.welcome(case), memory=control.encode_record(past)))


def test_a_residual_pushes_no_model_beyond_the_largest_number_of_the_radio() -> None:
    """A half ends at 65504; 65488 lies between two of them, and 16 remain for the next upload."""
    feedback, row = Feedback(Coding("float16", (1,)), 1, active=True), np.array([0])
    sent = [float(feedback.encode(row, np.array([[model]]))[0, 0]) for model in (65488.0, 65504.0)]
    assert sent == [65472.0, 65504.0]


def test_without_feedback_an_upload_is_the_rounded_model_and_no_residual_is_stored() -> None:
    case = nodes.flown("federation.payload=int8", "federation.error_feedback=false", "federation.fraction=1.0")
    agent, coding = Agent(nodes.welcome(case)), Coding("int8", HF)
    for seen, batch in uploads(agent, 21):
        np.testing.assert_array_equal(batch.payload, coding.encode(seen))
    assert RESIDUALS not in nodes.kept(agent, 21)


# -- fragments ---------------------------------------------------------------------------------------------------

LENGTH = 100_000


@pytest.fixture(autouse=True)
def _registered() -> None:
    mf.register(Long)


def flown(*keys: str, uavs: int = 6, length: int = 3600, duration: float = 10.5) -> Scenario:
    fixed = [f"uavs={uavs}", f"controller.length={length}", f"duration={duration}", 'stop="duration"']
    return load(None, [*fixed, "federation.fraction=1.0", *keys], method="long", seed=7)


@pytest.mark.parametrize("name", ["float64", "float32", "float16", "int8"])
@pytest.mark.parametrize("weighted", [False, True])
@settings(QUICK, max_examples=30)
@given(parts=st.lists(st.integers(1, 40), min_size=1, max_size=6), share=st.integers(1, 30), seed=st.integers(0, 99))
def test_fragments_of_a_model_are_the_model(name: Any, weighted: bool, parts: list[int], share: int, seed: int) -> None:
    length = sum(parts)
    if share >= length:
        return
    way = Coding(name, tuple(parts), Cut(1, share, 3), weighted=weighted)
    draw = np.random.default_rng(seed)
    models, samples = draw.normal(size=(3, length)), draw.integers(1, 99, 3).astype(float)
    payload = way.pack(way.encode(models), samples[:, None])
    way.check(np.arange(3), payload)
    rows = way.on_air(payload).reshape(3 * way.count, -1)
    source = np.arange(3).repeat(way.count)
    way.check_received(source, rows)
    pieces = way.received(rows)
    whole = pieces.values.reshape(3, -1)
    np.testing.assert_array_equal(whole[:, :length], way.decode(way.encode(models)))
    assert not whole[:, length:].any()
    assert pieces.weights.tolist() == (samples.repeat(way.count).tolist() if weighted else [1.0] * len(rows))
    one = way.received(rows[-1:])
    np.testing.assert_array_equal(one.values[0], pieces.values[-1])  # each is read without the others
    assert way.fragments is not None
    assert way.ticks == math.ceil(way.count / 3)
    assert way.count == math.ceil(length / share)


def test_a_fragment_has_room_for_its_number_and_costs_every_bit_of_it() -> None:
    case = flown(length=LENGTH, uavs=25)
    cut = plan_of(case).hops[0].coding.cut
    assert cut.slots == longest(case) == 3  # 97 % of them arrive; of those of 4 slots 90 %
    room = int(cut.slots * case.radio.bits_per_slot / 8)
    assert plan_of(case).hops[0].coding.fragments is not None
    width = plan_of(case).hops[0].coding.fragments.width
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
    assert after[1] + plan_of(case).hops[1].coding.ticks - 1 + case.hop_ticks <= 6  # ticks of a round


@pytest.mark.parametrize("topology", ["topology=leader", "clusters=2", "topology=neighbours"])
@pytest.mark.parametrize("by_samples", [False, True])
def test_without_losses_a_round_in_fragments_is_the_mean(topology: str, by_samples: bool) -> None:
    sure = ("controller.decay=1.0", "radio.rice_xi=1e4", "radio.bits_per_float=64", "duration=2.6")
    weighted = f"controller.by_samples={by_samples}".lower()
    case = flown(f"federation.{topology}", "federation.fragment=4", weighted, *sure)
    assert plan_of(case).hops[0].coding.count > 3
    engine = Engine(case, "mean")
    assert engine.complete()["radio"]["traffic"]["uplink"]["outages"] == 0
    start = Long(Long.Options(length=3600), case).init(np.arange(6), np.zeros((6, 4)))
    mean = np.average(start["model"], axis=0, weights=start["samples"] if by_samples else None)
    np.testing.assert_allclose(engine.crew.agents[0]._memory["model"], np.tile(mean, (6, 1)), rtol=1e-12, atol=1e-12)


def test_a_uav_fills_what_it_missed_from_the_last_global_model_and_not_from_its_own() -> None:
    way = Coding("float64", (4,), Cut(1, 2, 9))
    kept = GlobalModels(way, 2)

    class Learner:
        models = np.full((2, 4), 9.0)

        def models_to_send(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            return rows, self.models[rows], np.ones(len(rows))

        def take(self, rows: np.ndarray, models: np.ndarray) -> None:
            self.models[rows] = models

        def silent(self) -> np.ndarray:
            return np.zeros(2, dtype=bool)

    def arrive(model: list[float], *links: tuple[int, int]) -> None:
        rows = way.on_air(np.array([model]))[0]
        sent, row = np.array(links).T
        kept.add(sent, row, way.received(rows))

    learner = Learner()
    arrive([1.0, 2.0, 3.0, 4.0], (0, 0), (1, 0), (0, 1))
    kept.take(learner)
    assert learner.models.tolist() == [[1, 2, 3, 4], [1, 2, 9, 9]]  # the second never had a global one to fill from
    learner.models[:] = 7.0
    arrive([5.0, 6.0, 7.0, 8.0], (0, 0))
    kept.take(learner)
    assert learner.models.tolist() == [[5, 6, 3, 4], [7, 7, 7, 7]]


def mail_of(models: list[list[float]], lost: set[tuple[int, int]], to: int = 9) -> Joined:
    """Mail of models in fragments of two weights, without the fragments `lost`: (sender, number)."""
    way = Coding("float64", (len(models[0]),), Cut(1, 2, 9))
    rows = way.on_air(np.array(models, dtype=float)).reshape(len(models) * way.count, -1)
    source = np.arange(len(models), dtype=np.int32).repeat(way.count)
    number = np.tile(np.arange(way.count), len(models))
    links = [[row, to] for row in range(len(rows)) if (source[row], number[row]) not in lost]
    mail = Mail(way, np.array([to]))
    mail.add(Frames(FrameKind.UPLOAD, 1, source, rows, np.array(links, dtype=np.int32)))
    return Joined({1: mail}, way, np.array([to]))


def test_each_fragment_is_averaged_over_the_uavs_whose_copy_arrived() -> None:
    joined = mail_of([[1, 1, 1, 1], [3, 3, 3, 3], [8, 8, 8, 8]], lost={(2, 0), (0, 1), (1, 1), (2, 1)})
    uploads, *_ = joined.to(0, 1)
    assert uploads.arrived.tolist() == [[True, True, False, False], [True, True, False, False]]
    assert uploads.uavs.tolist() == [0, 1]  # nothing arrived of the third
    assert uploads.models[:, 2:].tolist() == [[0, 0], [0, 0]]
    case = flown()
    _, model = FedAvg(FedAvg.Options(), case).step({}, uploads)
    assert model.tolist() == [2, 2, 0, 0]
    _, middle = Median(Median.Options(), case).step({}, mail_of([[1, 1], [3, 3], [9, 9]], lost={(1, 0)}).to(0, 1)[0])
    assert middle.tolist() == [5, 5]
    own = OwnModel(1, np.array([7.0, 7.0, 7.0, 7.0]), 1.0)
    joined = mail_of([[1, 1, 1, 1], [0, 0, 0, 0], [4, 4, 4, 4]], lost={(1, 0), (1, 1), (2, 1)})
    uploads, *_ = joined.to(0, 1, own)
    assert uploads.uavs.tolist() == [0, 1, 2]
    assert FedAvg(FedAvg.Options(), case).step({}, uploads)[1].tolist() == [4, 4, 4, 4]


def test_of_late_uploads_the_latest_of_each_uav_counts_in_the_order_of_the_uavs() -> None:
    way, leader = Coding("float64", (1,)), np.array([9])
    mails = {number: Mail(way, leader) for number in (1, 2)}
    for number, uavs, models in ((1, [3, 5], [[1.0], [2.0]]), (2, [2, 5], [[7.0], [8.0]])):
        links = np.array([[0, 9], [1, 9]], dtype=np.int32)
        frames = Frames(FrameKind.UPLOAD, number, np.array(uavs, np.int32), way.encode(np.array(models)), links)
        mails[number].add(frames)
    uploads, *_ = Joined(mails, way, leader).to(0, 2)
    assert (uploads.uavs.tolist(), uploads.sent.tolist()) == ([2, 3, 5], [2, 1, 2])
    assert uploads.models[:, 0].tolist() == [7.0, 1.0, 8.0]


def test_a_fragment_that_nobody_delivered_is_not_broadcast() -> None:
    case = flown("federation.fragment=6", "duration=2.6", uavs=2)  # most are lost
    summary, sink = fly(case)
    bill = summary["radio"]["traffic"]
    assert any(
        f"{bill['uplink']['delivered']} of {plan_of(case).hops[0].coding.count} fragments arrived" in text
        for text in sink.texts
    )
    assert 0 < bill["uplink"]["delivered"] < plan_of(case).hops[0].coding.count
    assert bill["broadcast"]["transmissions"] == bill["uplink"]["delivered"]
    (text,) = [text for text in sink.texts if "of the global model were received" in text]
    _, sent, whole, part, nothing = map(int, re.findall(r"\d+", text))
    assert sent == bill["broadcast"]["transmissions"]
    assert (whole, part, nothing) == (0, 1, 0)
    assert 0 < bill["broadcast"]["delivered"] < sent


def test_models_are_whole_where_fragments_would_not_help_and_nodes_are_told_the_size_of_fragments() -> None:
    for whole in (flown("federation.fragment=0"), flown("radio.model=ideal"), flown(length=300)):
        assert plan_of(whole).hops[0].coding.fragments is None
        assert plan_of(whole).node_scenario.federation.fragment == 0
    assert plan_of(flown("federation.fragment=2", length=300)).hops[0].coding.count == 2
    told = plan_of(flown()).node_scenario
    assert told.federation.fragment == 3
    assert plan_of(told).hops[0].coding.cut == plan_of(flown()).hops[0].coding.cut


@pytest.mark.parametrize("cut", [None, Cut(1, 4, 9)], ids=["whole", "fragments"])
def test_an_average_of_weighted_models_has_their_number_and_the_sum_of_their_weights(cut: Cut | None) -> None:
    way = Counted("float32", 10, np.array([3, 3]), cut, weighted=True)
    fragments = way.count
    models, source = np.arange(20.0).reshape(2, 10), np.arange(2)
    behind = np.array([[1.0, 3.0, 2.0], [2.0, 1.0, 0.0]])[:, :fragments]
    weights = behind * 50.0
    payload = way.write(models, weights, behind)
    assert way.bits == 8 * payload.shape[1] == 32 * (10 + 2 * fragments)
    way.check(source, payload)
    sent = behind > 0.0
    rows = payload if cut is None else way.on_air(payload)[sent]
    way.check_received(source.repeat(sent.sum(axis=1)), rows)
    pieces = way.received(rows)
    assert (pieces.behind.tolist(), pieces.weights.tolist()) == (behind[sent].tolist(), weights[sent].tolist())
    np.testing.assert_array_equal(pieces.values[0], models[0, : 10 if cut is None else 4])
    for false in (0.0, -1.0, np.nan, np.inf, 4e30):  # of two or three models
        with pytest.raises(MessageRejected, match="weights"):
            way.check(source, way.write(models, np.where(behind == behind.max(), false, weights), behind))
    for too_many in (4.0, 1.5):
        with pytest.raises(MessageRejected, match="averages"):
            way.check(source, way.write(models, weights, np.where(behind == behind.max(), too_many, behind)))
    if cut is not None:
        with pytest.raises(MessageRejected, match="weights"):
            way.check(source, way.write(models, np.maximum(weights, 1.0), behind))  # a weight of no model


FALSE: dict[str, Any] = {  # fragments, changed in one way
    "out of order": lambda rows: rows[[1, 0, 2, 3, 4, 5]],
    "twice": lambda rows: rows[[0, 0, 2, 3, 4, 5]],
    "beyond the model": lambda rows: np.concatenate([rows[:-1], np.where(rows[-1:] == 2, np.uint8(3), rows[-1:])]),
    "of another size": lambda rows: rows[:, :-1],
    "of another type": lambda rows: rows.astype(np.int16),
    "not a number": lambda rows: np.where(np.arange(rows.shape[1]) >= 4, np.uint8(255), rows),
}


@pytest.mark.parametrize("how", FALSE)
def test_false_fragments_are_rejected(how: str) -> None:
    way = Coding("float32", (10,), Cut(1, 4, 9))
    rows, source = way.on_air(way.encode(np.ones((2, 10)))).reshape(6, -1), np.arange(2).repeat(3)
    way.check_received(source, rows)
    with pytest.raises(MessageRejected):
        way.check_received(source, FALSE[how](rows))


def test_int8_fragments_have_scales_of_their_own() -> None:
    way = Coding("int8", (6, 4), Cut(1, 4, 9))
    model = np.array([[1e-3] * 4 + [1e3] * 2 + [1.0] * 4])
    np.testing.assert_allclose(way.decode(way.encode(model)), model, rtol=1 / 250)
    assert way.width == 10 + 4 * 4  # pieces 0–3, 4–5, 6–7, 8–9
