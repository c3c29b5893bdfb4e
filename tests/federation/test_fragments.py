"""Models that are too long for one message: how they are cut, billed, lost, put together, and resumed in mid-round."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import meanflock as mf
from meanflock.federation.coding import Coding
from meanflock.federation.fragments import Cut, longest, resolved
from meanflock.federation.mail import Joined, Mail, Own
from meanflock.federation.memory import GlobalModels
from meanflock.federation.rules.fedavg import FedAvg
from meanflock.federation.rules.robust import Median
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames
from meanflock.worldsim.checkpoint import Resumption
from tests.telemetry import fly

LENGTH = 100_000


class Long(mf.Controller):
    """Shares a long model: a walk of its own from round to round, so that every round has something to average."""

    name = "long"
    period_ticks = 20

    class Options(mf.Options, frozen=True):
        length: int = 3000
        decay: float = 0.999

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.parameters, self.weights = options.length, 0
        self.parts = (options.length // 3, options.length - options.length // 3)

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> dict[str, Any]:
        return {"model": np.stack([np.random.default_rng(int(uav)).normal(size=self.parameters) for uav in uavs])}

    def step(self, memory: dict[str, Any], tick: int, own: np.ndarray, received: Any) -> mf.Step:
        pull = memory["model"][:, :2] * 0.01  # so that the flight depends on the model
        return mf.Step({"model": memory["model"] * self.options.decay}, pull - 0.05 * own[:, :2] - 0.3 * own[:, 2:])

    def get(self, memory: dict[str, Any]) -> np.ndarray:
        return np.asarray(memory["model"])

    def set(self, memory: dict[str, Any], rows: np.ndarray, models: np.ndarray) -> dict[str, Any]:
        after = memory["model"].copy()
        after[rows] = models
        return {"model": after}


@pytest.fixture(autouse=True)
def _registered() -> None:
    mf.register(Long)


def flown(*keys: str, uavs: int = 6, length: int = 3600, duration: float = 10.5) -> Scenario:
    fixed = [f"uavs={uavs}", f"controller.length={length}", f"duration={duration}", 'stop="duration"']
    return load(None, [*fixed, "federation.fraction=1.0", *keys], method="long", seed=7)


@pytest.mark.parametrize("name", ["float64", "float32", "float16", "int8"])
@pytest.mark.parametrize("weighted", [False, True])
@settings(max_examples=30, deadline=None, database=None)
@given(
    parts=st.lists(st.integers(1, 40), min_size=1, max_size=6),
    share=st.integers(1, 30),
    seed=st.integers(0, 99),
)
def test_fragments_of_a_model_are_the_model(name: Any, weighted: bool, parts: list[int], share: int, seed: int) -> None:
    length = sum(parts)
    if share >= length:
        return
    way = Coding(name, tuple(parts), Cut(1, share, 3), weighted=weighted)
    draw = np.random.default_rng(seed)
    models, samples = draw.normal(size=(3, length)), draw.integers(1, 99, 3).astype(float)
    payload = way.pack(way.encode(models), samples)
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
    of = flown(length=LENGTH, uavs=25)
    cut = of.hops[0].coding.cut
    assert cut is not None
    assert cut.slots == longest(of) == 3  # 97 % of them arrive; of those of 4 slots 90 %
    room = int(cut.slots * of.radio.bits_per_slot / 8)
    assert of.hops[0].coding.fragments is not None
    width = of.hops[0].coding.fragments.width
    assert room - 4 < width <= room
    assert cut.size == (room - 4) // 4
    assert cut.per_tick == 250  # ⌊0.1 s / (8 · 50 µs)⌋
    engine = Engine(of, "bill")
    bill = engine.complete()["radio"]["traffic"]
    fragments = 5 * 25 * math.ceil(LENGTH / cut.size)
    assert bill["uplink"]["transmissions"] == fragments - 5 * math.ceil(LENGTH / cut.size)  # the leader's own are free
    assert bill["uplink"]["payload_bits"] == 8 * width * bill["uplink"]["transmissions"]
    assert abs(bill["uplink"]["outage_rate"] - bill["uplink"]["outage_rate_theory"]) < 0.005
    after = [hop.after for hop in of.hops]
    assert after == [0, 2]
    assert after[1] + of.hops[1].coding.ticks - 1 + of.hop_ticks <= 6  # ticks of a round


TOPOLOGIES = ("leader", "clusters=2", "neighbours")


def of_topology(topology: str, *keys: str) -> Scenario:
    where = "federation.clusters=2" if "clusters" in topology else f"federation.topology={topology}"
    return flown(where, *keys)


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_without_losses_a_round_in_fragments_is_the_mean(topology: str) -> None:
    sure = (
        "controller.decay=1.0",
        "radio.rice_xi=1e4",
        "radio.bits_per_float=64",
        "federation.fragment=4",
        "duration=2.6",
    )
    of = of_topology(topology, *sure)
    assert of.hops[0].coding.count > 3
    engine = Engine(of, "mean")
    assert engine.complete()["radio"]["traffic"]["uplink"]["outages"] == 0
    start = Long(Long.Options(length=3600), of).init(np.arange(6), np.zeros((6, 4)))["model"]
    np.testing.assert_allclose(
        engine._agents[0]._memory["model"], np.tile(start.mean(axis=0), (6, 1)), rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize(
    ("topology", "keys"),
    [
        ("leader", ("federation.payload=int8",)),
        ("clusters=2", ()),
        ("neighbours", ("federation.upload_threshold=0.01",)),
        ("neighbours", ("federation.aggregation=median",)),
    ],
)
def test_a_flight_in_fragments_is_the_same_in_any_number_of_nodes_and_resumed_in_mid_round(
    topology: str, keys: tuple[str, ...]
) -> None:
    slow = ("radio.coherence_time_s=0.0125", "radio.bandwidth_hz=800", "radio.target_snr_db=109")
    of = of_topology(
        topology,
        *slow,
        "federation.period=45",
        "controller.length=360",
        "duration=125.0",
        "federation.fragment=3",
        *keys,
    )
    count = of.hops[0].coding.count
    assert of.hops[0].coding.ticks == count > 10  # one a tick
    whole, record = fly(of)
    assert whole["rounds"] + whole["rounds_void"] == 27
    assert whole["radio"]["outages"] > 0
    others = [fly(of, rows=2)[0]]
    blocks = [number for number, block in enumerate(record.blocks) if block.checkpoint]
    middles = set()
    for last in blocks:
        history = np.concatenate([block.states for block in record.blocks[: last + 1]])
        past = Resumption.decode(record.blocks[last].checkpoint, history)
        middles.add(past.tick % 45 // count)
        others.append(fly(of, resume=past)[0])
    assert len(middles & {0, 1}) >= 1  # while uploads, or averages, are transmitted
    for name in ("trajectory_sha256", "models_sha256", "payload_bits", "rounds", "uploads_silent"):
        assert [other[name] for other in others] == [whole[name]] * len(others), name


def test_a_uav_fills_what_it_missed_from_the_last_global_model_and_not_from_its_own() -> None:
    way = Coding("float64", (4,), Cut(1, 2, 9))
    kept = GlobalModels(way, 2)

    class Learner:
        models = np.full((2, 4), 9.0)

        def tell(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    uploads, _ = joined.to(0, 1)
    assert uploads.arrived.tolist() == [[True, True, False, False], [True, True, False, False]]
    assert uploads.uavs.tolist() == [0, 1]  # nothing arrived of the third
    assert uploads.models[:, 2:].tolist() == [[0, 0], [0, 0]]
    of = flown()
    _, model = FedAvg(FedAvg.Options(), of).step({}, uploads)
    assert model.tolist() == [2, 2, 0, 0]
    _, middle = Median(Median.Options(), of).step({}, mail_of([[1, 1], [3, 3], [9, 9]], lost={(1, 0)}).to(0, 1)[0])
    assert middle.tolist() == [5, 5]
    own = Own(1, np.array([7.0, 7.0, 7.0, 7.0]), 1.0)
    joined = mail_of([[1, 1, 1, 1], [0, 0, 0, 0], [4, 4, 4, 4]], lost={(1, 0), (1, 1), (2, 1)})
    uploads, _ = joined.to(0, 1, own)
    assert uploads.uavs.tolist() == [0, 1, 2]
    assert FedAvg(FedAvg.Options(), of).step({}, uploads)[1].tolist() == [4, 4, 4, 4]


def test_a_fragment_that_nobody_delivered_is_not_broadcast() -> None:
    of = flown("federation.fragment=6", "duration=2.6", uavs=2)  # most are lost
    summary, sink = fly(of)
    bill = summary["radio"]["traffic"]
    assert any(
        f"{bill['uplink']['delivered']} of {of.hops[0].coding.count} fragments arrived" in text for text in sink.texts
    )
    assert 0 < bill["uplink"]["delivered"] < of.hops[0].coding.count
    assert bill["broadcast"]["transmissions"] == bill["uplink"]["delivered"]


REFUSED = {
    "period": (("federation.period=3",), "take at least 4"),
    "no room": (("federation.fragment=1", "radio.bandwidth_hz=1000"), "federation.fragment"),
    "krum": (("federation.aggregation=krum", f"controller.length={LENGTH}"), "krum"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_fly_in_fragments_is_refused(what: str) -> None:
    keys, text = REFUSED[what]
    with pytest.raises(BadInput, match=text):
        Engine(flown(*keys, length=LENGTH if what != "no room" else 3000), "refused")


def test_zero_slots_and_an_ideal_channel_leave_models_whole() -> None:
    assert flown("federation.fragment=0").hops[0].coding.fragments is None
    assert flown("radio.model=ideal").hops[0].coding.fragments is None
    assert flown(length=300).hops[0].coding.fragments is None
    assert flown("federation.fragment=2", length=300).hops[0].coding.count == 2


def test_nodes_get_the_size_of_fragments_written_out() -> None:
    of = flown()
    told = resolved(of)
    assert told.federation.fragment == 3
    assert told.hops[0].coding.cut == of.hops[0].coding.cut
    assert resolved(flown(length=300)).federation.fragment == 0


def hostile(rows: np.ndarray, source: np.ndarray, how: str) -> tuple[np.ndarray, np.ndarray]:
    """Fragments and their UAVs, changed in one way."""
    rows, source = rows.copy(), source.copy()
    match how:
        case "out of order":
            rows[[0, 1]] = rows[[1, 0]]
        case "twice":
            rows[1] = rows[0]
        case "beyond the model":
            rows[-1, :4] = np.array([99], dtype="<u4").view(np.uint8)
        case "of another size":
            rows = rows[:, :-1]
        case "of another type":
            rows = rows.astype(np.int16)
        case "not a number":
            rows[0, 4:8] = np.array([np.nan], dtype="<f4").view(np.uint8)
    return rows, source


@pytest.mark.parametrize(
    "how", ["out of order", "twice", "beyond the model", "of another size", "of another type", "not a number"]
)
def test_false_fragments_are_rejected(how: str) -> None:
    way = Coding("float32", (10,), Cut(1, 4, 9))
    rows = way.on_air(way.encode(np.ones((2, 10)))).reshape(6, -1)
    source = np.arange(2).repeat(3)
    way.check_received(source, rows)
    false, uavs = hostile(rows, source, how)
    with pytest.raises(MessageRejected):
        way.check_received(uavs, false)


def test_int8_fragments_have_scales_of_their_own() -> None:
    way = Coding("int8", (6, 4), Cut(1, 4, 9))
    model = np.array([[1e-3] * 4 + [1e3] * 2 + [1.0] * 4])
    np.testing.assert_allclose(way.decode(way.encode(model)), model, rtol=1 / 250)
    assert way.width == 10 + 4 * 4  # pieces 0–3, 4–5, 6–7, 8–9
