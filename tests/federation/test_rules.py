"""Aggregation rules: by hand, in any order, with states and failures, under false uploads; those of the examples."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import meanflock as mf
from meanflock.federation.byzantine import Byzantine
from meanflock.federation.rules.base import Aggregator, State, Uploads, mean
from meanflock.federation.rules.robust import suspects
from meanflock.launch import engine
from meanflock.launch.engine import Engine
from meanflock.leader.node import Leader
from meanflock.results.rounds_table import rounds_table
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.events import AverageFailed, ClusterLeftOut, RoundEnded
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames
from tests.agent import nodes
from tests.faults.conftest import Lab, scenario
from tests.federation.plugins import Momentum
from tests.memory_swarm import MemorySwarm
from tests.pages import script_of
from tests.telemetry import Record, fly


def average(rule: str, models: np.ndarray, tolerance: float = 0.25, **options: Any) -> np.ndarray:
    scenario = load(None, [f"federation.tolerance={tolerance}"])
    instance = plugins.create("aggregator", rule, options, scenario)
    state, model = instance.step(instance.init(models.shape[1]), Uploads.complete(models.astype(np.float64)))
    assert not state
    return np.asarray(model)


def test_means_are_weighted_by_their_precisions() -> None:
    table = [  # x of two quantities, y of them, precisions
        [1.0, 5.0, 10.0, 7.0, 1.0, 0.0],
        [4.0, 6.0, 40.0, 8.0, 3.0, 0.0],
        [9.0, 7.0, 90.0, 9.0, 0.0, 0.0],
    ]
    assert average("precision", np.array(table), means=2).tolist() == [13 / 4, 6.0, 130 / 4, 8.0, 4 / 3, 0.0]
    below_zero = np.array([[1.0, 2.0], [100.0, -5.0]])  # such a precision does not count
    assert average("precision", below_zero, means=1).tolist() == [1.0, 1.0]
    with pytest.raises(ValueError, match="10 numbers is no 3 vectors"):
        average("precision", np.ones((1, 10)), means=2)


FLOATS, OPENS, CLOSES = 108, 10, 14
# Ties, both zeros, and numbers that vanish beside others; sums of the rough numbers below depend on their order.
NUMBERS = st.one_of(st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-40, 1e8, -1e8]), st.floats(-1e6, 1e6, allow_nan=False))
# Uploads come over four ticks; floats of 64 bits show the last bit of a sum.
SLOW = ("radio.coherence_time_s=0.1", "radio.latency_threshold_slots=4", "radio.bits_per_float=64")


def broadcast(case: Scenario, models: np.ndarray, arrivals: list[tuple[int, int]]) -> bytes:
    """The global model of `models` (N, L) that arrive as (tick after the opening, UAV), each in its own batch."""
    node, said = Leader(nodes.welcome(case, ())), b""
    for tick in range(OPENS + 1, CLOSES + 1):
        batches = [
            Frames(FrameKind.UPLOAD, 1, np.array([uav], np.int32), models[[uav]], np.zeros((1, 2), np.int32))
            for after, uav in arrivals
            if OPENS + after == tick
        ]
        for frames in node.act(nodes.sense(tick, *batches, uavs=())).outbox:
            said += frames.payload.tobytes()
    return said


@pytest.mark.parametrize("rule", ["fedavg", "median", "trimmed-mean", "krum"])
def test_the_order_of_arrival_leaves_no_trace_in_the_global_model(rule: str) -> None:
    case = nodes.flown(*SLOW, f"federation.period={OPENS}", f'federation.aggregation="{rule}"', method="mfgfl-h")
    orders = st.permutations(range(case.uavs))
    ticks = st.lists(st.integers(1, 4), min_size=case.uavs, max_size=case.uavs)

    @settings(max_examples=25, deadline=None, database=None)
    @given(hnp.arrays(np.float64, (case.uavs, 3), elements=NUMBERS), orders, ticks, st.integers(1, case.uavs))
    def check(few: np.ndarray, order: list[int], when: list[int], count: int) -> None:
        rough = np.random.default_rng(count).normal(size=(8, FLOATS // 2)) * 10.0 ** np.arange(8)[:, None]
        models = np.concatenate([np.tile(few, FLOATS // 6), rough], axis=-1)
        arriving = sorted(order[:count])
        expected = broadcast(case, models, [(1, uav) for uav in arriving])
        assert len(expected) == 8 * FLOATS * (arriving != [case.federation.leader])
        shuffled = [(when[uav], uav) for uav in order[:count]]
        assert broadcast(case, models, shuffled) == expected

    check()


def flown(rule_class: type[Aggregator], *settings: str) -> Scenario:
    plugins.register(rule_class)
    fixed = ["uavs=4", "federation.period=10", f"federation.aggregation={rule_class.name}", 'stop="duration"']
    return load(None, [*fixed, "duration=6", *settings], method="mfgfl-h")


def wrong(**methods: Any) -> type[Aggregator]:
    return type("Wrong", (Momentum,), methods)


@pytest.mark.parametrize("tick", [15, 31, 32])
def test_a_standby_that_takes_over_averages_on_as_the_leader_would_have(tick: int) -> None:
    calm, _ = fly(flown(Momentum))
    summary, sink = fly(flown(Momentum, f"faults=[{{kind='leader-loss', tick={tick}}}]"))
    assert any("takes over" in text for text in sink.texts)
    assert summary["rounds"] == calm["rounds"]
    assert summary["trajectory_sha256"] == calm["trajectory_sha256"]


def fails(*_: Any) -> Any:
    raise OSError("no such table")


def in_round_two(spoil: Any) -> Any:
    def step(self: Momentum, state: State, uploads: Uploads) -> Any:
        good = Momentum.step(self, state, uploads)
        return spoil(*good) if uploads.round == 2 else good

    return step


FAILURES: list[tuple[Any, str]] = [
    (fails, "OSError: no such table"),
    (lambda _state, _model: None, "`step` returns a NoneType; expected the state and the model"),
    (lambda state, model: (state | {"models": model}, model), "state has ['change', 'model', 'models', 'rounds']"),
    (lambda state, model: (state | {"change": model * np.inf}, model), "state['change'] is not finite"),
    (
        lambda state, model: (state | {"rounds": np.float64(1.0)}, model),
        "state['rounds'] is () float64, no array; of `init` it was (1,) float64",
    ),
    (lambda state, model: (state, model[:-1]), "the model has shape (107,); expected (108,)"),
    (lambda state, model: (state, model * np.nan), "the model is not finite"),
    (lambda state, model: (state, model * 1j), "the model is complex128 (108,); expected real numbers (108,)"),
]


@pytest.mark.parametrize(("spoil", "expected"), FAILURES, ids=[expected for _, expected in FAILURES])
def test_a_rule_that_fails_makes_its_round_void_and_the_flight_goes_on(spoil: Any, expected: str) -> None:
    summary, sink = fly(flown(wrong(step=in_round_two(spoil))))
    assert summary["ticks"] == 60
    assert (summary["lost"], summary["nodes_lost"], summary["dropped_messages"]) == (0, 0, {})
    assert (summary["rounds"], summary["rounds_void"]) == (4, 1)
    assert any("round 2 is void: the aggregation rule failed" in text for text in sink.texts)
    (text,) = [text for text in sink.texts if "failed in round" in text]
    assert "aggregator 'momentum' failed in round 2" in text
    assert expected in text


@pytest.mark.parametrize("rows", [4, 2, 1])
@pytest.mark.parametrize("swarm", [Engine, MemorySwarm])
def test_uavs_where_a_rule_fails_average_nothing(swarm: type[Engine | MemorySwarm], rows: int) -> None:
    """It fails at all UAVs in round 2, and at two of four in round 3."""

    def step(self: Momentum, state: State, uploads: Uploads) -> Any:
        own = uploads.uavs[uploads.slots == 0]
        if uploads.round == 2 or (uploads.round == 3 and own[0] < 2):
            fails()
        return Momentum.step(self, state, uploads)

    record = Record()
    near = flown(wrong(step=step), "federation.topology=neighbours", "federation.fraction=1", "radio.target_snr_db=60")
    summary = swarm(near, "failing", uavs_per_node=rows, sinks=[record]).complete()
    rounds = {event.number: event for event in record.events if isinstance(event, RoundEnded)}
    assert [(one.outcome, one.averaging, one.isolated) for one in rounds.values()] == [
        ("averaged", 4, 0),
        ("void", 0, 0),
        ("averaged", 2, 0),
        ("averaged", 4, 0),
        ("averaged", 4, 0),
    ]
    assert rounds[2].reason == "the aggregation rule failed"
    assert (summary["rounds"], summary["rounds_void"], summary["lost"]) == (4, 1, 0)
    failures = [event for event in record.events if isinstance(event, AverageFailed)]
    assert sorted(uav for event in failures for uav in event.uavs) == [0, 0, 1, 1, 2, 3]
    assert all("failed in round" in event.text and "OSError: no such table" in event.text for event in failures)


class Patient(Momentum):
    """At UAVs 0 and 1 it averages in every second round, at UAVs 2 and 3 in every third. In round 5 it fails at 0."""

    name = "patient"
    bears_means = True

    def step(self, state: State, uploads: Uploads) -> Any:
        (own,) = uploads.uavs[uploads.slots == 0]
        if (own, uploads.round) == (0, 5):
            fails()
        after = state | {"rounds": state["rounds"] + 1.0}
        return after, None if after["rounds"][0] % (2 if own < 2 else 3) else uploads.mean


def ends_of_rounds(record: Record) -> list[tuple[int, str, str, int | None, int]]:
    ended = [event for event in record.events if isinstance(event, RoundEnded)]
    return [(one.number, one.outcome, one.reason, one.averaging, one.isolated) for one in ended]


@pytest.mark.parametrize("rows", [4, 3, 1])
@pytest.mark.parametrize("swarm", [Engine, MemorySwarm])
def test_uavs_where_a_rule_waits_do_not_average_also_resumed(
    swarm: type[Engine | MemorySwarm], rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("meanflock.worldsim.world.REPORT_EVERY_TICKS", 1)
    monkeypatch.setattr(engine, "_checkpoint_every", lambda *_: 1)
    near = flown(Patient, "federation.topology=neighbours", "federation.fraction=1", "radio.target_snr_db=60")
    whole, rest = Record(), Record()
    summary = swarm(near, "waiting", uavs_per_node=rows, sinks=[whole]).complete()
    expected = [
        (1, "waiting", "", 0, 0),
        (2, "averaged", "", 2, 0),
        (3, "averaged", "", 2, 0),
        (4, "averaged", "", 2, 0),
        (5, "waiting", "", 0, 0),
    ]
    assert ends_of_rounds(whole) == expected
    assert (summary["rounds"], summary["rounds_void"], summary["dropped_messages"]) == (3, 0, {})
    table = rounds_table([event for event in whole.events if isinstance(event, RoundEnded)], near.dt)
    assert table["averaging"].to_pylist() == [0, 2, 2, 2, 0]
    past = next(past for past in whole.checkpoints if past.tick == 25)
    later = swarm(near, "waiting", uavs_per_node=2, sinks=[rest], resume=past).complete()
    assert ends_of_rounds(rest) == expected[2:]
    same = ("rounds", "rounds_void", "trajectory_sha256", "payload_bits")
    assert [later[name] for name in same] == [summary[name] for name in same]


@pytest.mark.parametrize("swarm", [Engine, MemorySwarm])
def test_heads_where_a_rule_waits_send_nothing_and_the_leader_waits_if_all_do(
    swarm: type[Engine | MemorySwarm],
) -> None:
    record = Record()
    clusters = ("federation.clusters=2", "federation.leader=0", "federation.fraction=1", "radio.target_snr_db=60")
    summary = swarm(flown(Patient, *clusters, "duration=5"), "waiting", uavs_per_node=2, sinks=[record]).complete()
    outcomes = [outcome for _, outcome, *_ in ends_of_rounds(record)]
    assert outcomes == ["waiting", "averaged", "averaged", "averaged"]
    assert (summary["rounds"], summary["rounds_void"], summary["dropped_messages"]) == (3, 0, {})
    reason = "its aggregation rule waits for more models"
    expected = [(0, 1), (2, 1), (2, 2), (0, 3), (2, 4)]
    assert [event.text for event in record.events if event.kind == "void"] == [
        f"round {number} goes on without the cluster of UAV {head}: {reason}" for head, number in expected
    ]


@pytest.mark.parametrize("swarm", [Engine, MemorySwarm])
def test_heads_where_a_rule_fails_send_nothing_and_the_round_is_void_if_all_fail(
    swarm: type[Engine | MemorySwarm],
) -> None:
    """It fails at one of two heads in round 2, and at both in round 3."""

    def step(self: Momentum, state: State, uploads: Uploads) -> Any:
        (own,) = uploads.uavs[uploads.slots == 0]
        if uploads.round == 3 or (own, uploads.round) == (2, 2):
            fails()
        return state, uploads.mean

    record = Record()
    clusters = ("federation.clusters=2", "federation.leader=0", "federation.fraction=1", "radio.target_snr_db=60")
    case = flown(wrong(step=step, bears_means=True), *clusters, "duration=5")
    summary = swarm(case, "failing", uavs_per_node=2, sinks=[record]).complete()
    ended = [(outcome, reason) for _, outcome, reason, *_ in ends_of_rounds(record)]
    assert ended == [("averaged", ""), ("averaged", ""), ("void", "the aggregation rule failed"), ("averaged", "")]
    assert (summary["rounds"], summary["rounds_void"], summary["dropped_messages"]) == (3, 1, {})
    left_out = [event.text for event in record.events if isinstance(event, ClusterLeftOut)]
    assert left_out == [
        f"round {number} goes on without the cluster of UAV {head}: its aggregation rule failed"
        for head, number in [(2, 2), (0, 3), (2, 3)]
    ]


@pytest.mark.parametrize("topology", ["leader", "neighbours"])
def test_a_rule_fails_in_every_round_also_where_a_node_may_tell_no_more(topology: str) -> None:
    """A node may send 101 events here, and there are more rounds."""
    case = flown(wrong(step=fails), f"federation.topology={topology}", "duration=110", "radio.target_snr_db=60")
    forms = [swarm(case, "failing", uavs_per_node=1).complete() for swarm in (Engine, MemorySwarm)]
    assert [(one["rounds"], one["rounds_void"]) for one in forms] == [(0, 109)] * 2
    assert forms[1]["dropped_messages"]["oversized"] > 0


def test_a_rule_that_waits_for_more_keeps_its_state_and_nothing_is_broadcast() -> None:
    """It averages in every second round: neither a complaint nor a model in the others."""

    def step(_self: Momentum, state: State, uploads: Uploads) -> tuple[State, np.ndarray | None]:
        assert state["rounds"][0] == uploads.round - 1
        return state | {"rounds": state["rounds"] + 1.0}, mean(uploads.models) if uploads.round % 2 == 0 else None

    summary, sink = fly(flown(wrong(step=step)))
    assert (summary["rounds"], summary["rounds_void"]) == (2, 0)
    assert sum("the aggregation rule waits for more models" in text for text in sink.texts) == 3
    assert not [text for text in sink.texts if "failed" in text]


@pytest.mark.parametrize("topology", ["leader", "neighbours"])
def test_a_state_of_four_axes_is_in_every_checkpoint(topology: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where each UAV averages, a node stores a state for each of its UAVs, with one axis more."""
    monkeypatch.setattr(engine, "_checkpoint_every", lambda *_: 10)
    deep = wrong(init=lambda *_: {"deep": np.zeros((2, 2, 2, 2))}, step=lambda _, state, given: (state, given.mean))
    summary, sink = fly(flown(deep, f"federation.topology={topology}", "duration=3"))
    assert summary["dropped_messages"] == {}
    assert sum(bool(block.checkpoint) for block in sink.blocks) >= 2


def test_a_global_model_beyond_the_radio_s_floats_is_not_sent_but_the_state_is_kept() -> None:
    summary, sink = fly(flown(wrong(step=in_round_two(lambda state, model: (state, np.full_like(model, 1e300))))))
    assert summary["rounds"] == 4
    assert any("the global model has 1e+300, beyond what the radio's floats can say" in text for text in sink.texts)


@pytest.mark.parametrize(
    ("methods", "expected"),
    [
        ({"step": lambda _self, _state, _models, _uavs, _round: None}, r"write step\(self, state, uploads\)"),
        ({"init": fails}, r"aggregator 'momentum' failed in `init`: OSError: no such table"),
        ({"init": lambda *_: {"last": np.zeros(4_000_000)}}, r"the state has 32000000 bytes; at mo"),
        ({"init": lambda *_: {"last": np.full(2, np.nan)}}, r"is not finite"),
    ],
)
def test_a_rule_that_cannot_begin_is_bad_input_of_one_line(methods: dict[str, Any], expected: str) -> None:
    with pytest.raises(BadInput, match=expected) as caught:
        Engine(flown(wrong(**methods)), "rules")
    assert len(str(caught.value).splitlines()) == 1


ROBUST = ("median", "trimmed-mean", "krum")


@pytest.mark.parametrize("rule", ROBUST)
def test_a_fifth_of_false_uploads_moves_no_weight_out_of_the_honest_range(rule: str) -> None:
    @settings(max_examples=60, database=None)
    @given(
        hnp.arrays(np.float64, (8, 3), elements=st.floats(-1, 1)),
        hnp.arrays(np.float64, (2, 3), elements=st.floats(-1e8, 1e8)),
    )
    def check(honest: np.ndarray, false: np.ndarray) -> None:
        averaged = average(rule, np.concatenate([honest, false]))
        if rule == "krum":  # one whole model; where a false one is chosen it hides among the honest
            spread = np.abs(honest[:, None] - honest[None]).max()
            assert np.abs(averaged - honest).max() <= 4 * np.sqrt(3) * spread + 1e-12
        else:
            assert (averaged >= honest.min(axis=0) - 1e-12).all()
            assert (averaged <= honest.max(axis=0) + 1e-12).all()

    check()


def test_each_rule_is_what_it_is_called() -> None:
    models = np.array([[1.0, 5.0], [2.0, 4.0], [9.0, -7.0], [3.0, 3.0]])
    np.testing.assert_array_equal(average("median", models), [2.5, 3.5])
    np.testing.assert_array_equal(average("median", models[:3]), [2.0, 4.0])
    np.testing.assert_array_equal(average("trimmed-mean", models), [2.5, 3.5])
    np.testing.assert_array_equal(average("trimmed-mean", models, tolerance=0.0), models.mean(axis=0))
    np.testing.assert_array_equal(average("krum", models), [1.0, 5.0])  # as near as [3, 3]: the smaller
    assert [suspects(n, 0.2) for n in (1, 2, 3, 5, 10, 20)] == [0, 0, 1, 1, 2, 4]
    for rule in ROBUST:
        for count in (1, 2, 3, 4, 7):
            np.testing.assert_array_equal(average(rule, models[[0] * count]), models[0])


def false_swarm(*extra: str) -> tuple[str, ...]:
    return ("uavs=10", "federation.fraction=1.0", "federation.byzantine_fraction=0.2", *extra)


def test_the_false_uavs_are_drawn_from_the_seed_and_the_leader_is_never_one() -> None:
    for seed in range(20):
        case = load(None, [*false_swarm(f"seed={seed}", "federation.leader=4")], method="mfgfl-h")
        chosen = Byzantine(case).uavs
        assert len(chosen) == 2
        assert 4 not in chosen
        np.testing.assert_array_equal(chosen, Byzantine(case).uavs)
    assert len({tuple(Byzantine(load(None, [*false_swarm(f"seed={s}")])).uavs) for s in range(9)}) > 1
    assert not len(Byzantine(load(None)).uavs)


# The largest half-precision number is not absurd: that mean is a disaster. Bytes have scales in single precision.
REFUSED = {("huge", "radio.bits_per_float=32"), ("huge", "federation.payload=int8")}
WIDTHS = ("radio.bits_per_float=32", "radio.bits_per_float=16", "federation.payload=int8")


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("kind", ["huge", "sign-flip", "noise"])
def test_a_false_upload_changes_the_flight_or_is_refused_and_named(kind: str, width: str) -> None:
    short = ("duration=7", width)
    lab = Lab(scenario(*false_swarm(f"federation.byzantine_kind={kind}", *short)))
    summary = lab.fly()
    honest = Lab(scenario("uavs=10", "federation.fraction=1.0", *short)).fly()
    refused = (kind, width) in REFUSED
    assert summary["trajectory_sha256"] != honest["trajectory_sha256"]
    assert (summary["uploads_refused"], honest["uploads_refused"]) == (3 * 2 if refused else 0, 0)
    assert summary["dropped_messages"] == {}
    assert (summary["rounds"], honest["rounds"]) == (1 if kind == "huge" and not refused else 3, 3)
    false = ", ".join(map(str, Byzantine(lab.world.scenario).uavs))
    texts = {event.text for event in lab.record.events if event.kind == "refused"}
    assert texts == ({f"uploads of UAVs {false} were not averaged"} if refused else set())


# -- the examples: they fly, and compute what their papers say --------------------------------------------------------

classifier, fedadam, scaffold = (script_of(name, "examples") for name in ("classifier", "fedadam", "scaffold"))

EXAMPLES = {
    "fedadam": fedadam.FedAdam,
    "fedbuff": script_of("fedbuff", "examples").FedBuff,
    "inverse-probability": script_of("inverse_probability", "examples").InverseProbability,
    "scaffold": scaffold.ScaffoldRule,
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_fly(name: str) -> None:
    plugins.register(EXAMPLES[name])
    settings = {"federation.aggregation": name, "federation.fraction": 1.0, "federation.period": 20}
    method = scaffold.Scaffold if name == "scaffold" else "fed-lspi"
    run = mf.fly(method=method, uavs=9, seed=3, duration=20, **settings)
    assert run.summary["rounds"] >= (1 if name == "fedbuff" else 8)
    assert run.summary["rounds"] + run.summary["rounds_void"] <= 9
    assert not [event for event in run.events if "failed" in event["text"]]
    assert run.summary["lost"] == 0


def test_fedadam_takes_the_step_that_was_worked_by_hand() -> None:
    rule = fedadam.FedAdam(fedadam.FedAdam.Options(eta=0.1, beta1=0.5, beta2=0.75, tau=0.2), mf.Scenario())
    state, model = rule.step(rule.init(2), mf.Uploads.complete(np.array([[1.0, 0.0], [3.0, 0.0]])))
    assert model.tolist() == [2.0, 0.0]
    state, model = rule.step(state, mf.Uploads.complete(np.array([[2.0, -0.4], [3.0, -0.4]]), 2))
    # Δ = [0.5, −0.4]; m = Δ/2; v = 0.75 · 0.04 + 0.25 Δ² = [0.0925, 0.07]; x ← x + 0.1 m / (√v + 0.2)
    expected = [2.0 + 0.1 * 0.25 / (np.sqrt(0.0925) + 0.2), -0.1 * 0.2 / (np.sqrt(0.07) + 0.2)]
    np.testing.assert_allclose(model, expected, rtol=1e-15)
    np.testing.assert_allclose(state["v"], [0.0925, 0.07], rtol=1e-15)


def test_the_control_variates_of_scaffold_have_the_leaders_as_their_mean() -> None:
    """c = Σ c_i / N after every round in which all take part, and s is the mean of the K corrected gradients."""
    plugins.register(scaffold.ScaffoldRule)
    settings = {
        "radio.model": "ideal",
        "radio.bits_per_float": 64,
        "federation.fraction": 1.0,
        "federation.aggregation": "scaffold",
    }
    seen: list[Any] = []

    class Watched(scaffold.Scaffold):
        name = "watched"

        def step(self, memory: Any, tick: int, own: Any, received: Any) -> Any:
            seen.append((tick, memory))
            return super().step(memory, tick, own, received)

    Engine(mf.Scenario(method=Watched, uavs=6, stop="duration", duration=20, seed=2, **settings), "flight").complete()
    flown = dict(seen)
    for tick in range(29, 200, 20):  # between two rounds
        models, shared = flown[tick]["model"][:, :2], flown[tick]["global"][:, 2:]
        assert np.abs(shared).max() > 1e-4
        np.testing.assert_allclose(flown[tick]["variate"].mean(axis=0), shared[0], atol=1e-15)
        assert len(np.unique(models, axis=0)) == len(np.unique(shared, axis=0)) == 1
    steps = [flown[tick]["model"][:, :2] - flown[tick + 1]["model"][:, :2] for tick in range(50, 60)]
    mean = np.mean(steps, axis=0) / scaffold.RATE
    np.testing.assert_allclose(flown[60]["model"][:, 2:], mean, atol=1e-12)
    before = flown[50]["variate"] - flown[50]["global"][:, 2:]
    np.testing.assert_allclose(flown[61]["variate"], before + mean, atol=1e-12)


def test_the_rule_of_scaffold_moves_by_the_share_of_the_uavs_that_took_part() -> None:
    rule = scaffold.ScaffoldRule(scaffold.ScaffoldRule.Options(), mf.Scenario(uavs=4))
    uploads = mf.Uploads.complete(np.array([[1.0, 1.0, 0.5, 0.0], [3.0, 1.0, 0.7, 0.4]]))
    state, model = rule.step({"shared": np.array([0.2, 0.2])}, uploads)
    np.testing.assert_allclose(model, [2.0, 1.0, 0.2 + 0.5 * (0.6 - 0.2), 0.2], rtol=1e-15)  # |S| = 2 of N = 4
    assert state["shared"].tolist() == model[2:].tolist()


def test_the_program_prints_a_line_for_each_way_and_writes_a_picture(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["classifier.py", "--rounds", "6", "--uavs", "5"])
    monkeypatch.chdir(tmp_path)
    classifier.main()
    lines = re.findall(r"^(.+): ([\d.]+)% of the tests, .* ([\d.]+) Mbit$", capsys.readouterr().out, re.M)
    assert [way for way, _, _ in lines] == list(classifier.WAYS)
    assert lines[0][2] == "0.0"
    assert float(lines[0][1]) < 25.0 < float(lines[2][1])
    assert Path("out/classifier/accuracy.png").stat().st_size > 10_000


def test_sharing_makes_a_classifier_of_all_digits_and_pays_for_every_fragment() -> None:
    """Twenty rounds, the accuracy of the UAV that is worst; over a radio that loses half of the fragments, too."""
    flown = {way: classifier.fly(way, 10, 20) for way in classifier.WAYS}
    least = {way: rows[-1][1] for way, rows in flown.items()}
    assert least["alone"] <= 0.25
    assert min(least["leader"], least["neighbours"]) >= 0.88
    assert min(least["lossy, leader"], least["lossy, neighbours"]) >= 0.7
    bits = [bits for _, _, bits in flown["neighbours"]]
    assert bits == [bits[1] * number for number in range(21)]
    assert 10 * 32 * 2410 <= bits[1] < 1.1 * 10 * 32 * 2410
