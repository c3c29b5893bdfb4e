"""A few false uploads: what each rule of aggregation withstands, and what the leader will not average at all."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from meanflock.federation.averager import ABSURD, usable
from meanflock.federation.byzantine import Byzantine
from meanflock.federation.rules.fedavg import mean
from meanflock.federation.rules.robust import suspects
from meanflock.swarm import plugins
from meanflock.swarm.scenario import load
from tests.faults.conftest import Lab, scenario

QUICK = settings(max_examples=60, deadline=None, database=None)
Rule = Callable[[dict[int, np.ndarray]], np.ndarray]


def rule(name: str, tolerance: float) -> Rule:
    """A rule of ours, of models by UAV."""
    made = plugins.create("aggregator", name, {}, load(None, [f"federation.tolerance={tolerance}"]))

    def of(arrived: dict[int, np.ndarray]) -> np.ndarray:
        state, model = made.step(made.init(0), stacked(arrived), np.array(sorted(arrived)), 1)
        assert not state
        return np.asarray(model)

    return of


def stacked(arrived: dict[int, np.ndarray]) -> np.ndarray:
    return np.stack([arrived[uav] for uav in sorted(arrived)]).astype(np.float64)


def mail(rows: np.ndarray) -> dict[int, tuple[np.ndarray, float]]:
    return {uav: (model, 1.0) for uav, model in enumerate(rows)}


def fedavg(arrived: dict[int, np.ndarray]) -> np.ndarray:
    return mean(stacked(arrived))


ROBUST: dict[str, Rule] = {name: rule(name, 0.25) for name in ("median", "trimmed-mean", "krum")}
NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)
TABLES = st.tuples(st.integers(1, 9), st.integers(1, 4)).flatmap(lambda s: hnp.arrays(np.float64, s, elements=NUMBERS))


def models(rows: np.ndarray) -> dict[int, np.ndarray]:
    return dict(enumerate(rows))


@pytest.mark.parametrize("name", ["fedavg", *ROBUST])
def test_the_order_of_arrival_leaves_no_trace_to_the_last_bit(name: str) -> None:
    @QUICK
    @given(TABLES, st.randoms(use_true_random=False))
    def check(rows: np.ndarray, shuffler: object) -> None:
        order = list(range(len(rows)))
        shuffler.shuffle(order)  # type: ignore[attr-defined]
        of = rule(name, 0.25)
        assert of({uav: rows[uav] for uav in order}).tobytes() == of(models(rows)).tobytes()

    check()


@pytest.mark.parametrize("name", ROBUST)
def test_who_sent_which_model_leaves_no_trace_to_the_last_bit(name: str) -> None:
    @QUICK
    @given(TABLES, st.randoms(use_true_random=False))
    def check(rows: np.ndarray, shuffler: object) -> None:
        order = list(range(len(rows)))
        shuffler.shuffle(order)  # type: ignore[attr-defined]
        assert ROBUST[name](models(rows[order])).tobytes() == ROBUST[name](models(rows)).tobytes()

    check()


@pytest.mark.parametrize("name", ROBUST)
def test_a_fifth_of_false_uploads_moves_no_weight_out_of_the_honest_range(name: str) -> None:
    @QUICK
    @given(
        hnp.arrays(np.float64, (8, 3), elements=st.floats(-1, 1)),
        hnp.arrays(np.float64, (2, 3), elements=st.floats(-1e8, 1e8)),
    )
    def check(honest: np.ndarray, false: np.ndarray) -> None:
        made = ROBUST[name](models(np.concatenate([honest, false])))
        if name == "krum":  # one whole model; where a false one is chosen it hides among the honest
            spread = np.abs(honest[:, None] - honest[None]).max()
            assert np.abs(made - honest).max() <= 4 * np.sqrt(3) * spread + 1e-12
        else:
            assert (made >= honest.min(axis=0) - 1e-12).all()
            assert (made <= honest.max(axis=0) + 1e-12).all()

    check()


def test_the_mean_does_break_down_with_one_false_upload() -> None:
    rows = np.zeros((10, 3))
    rows[0] = 1e8
    assert fedavg(models(rows)).min() > 1e6


def test_robust_rules_of_equal_models_are_that_model_and_of_one_are_it() -> None:
    one = np.array([1.5, -2.0, 0.25])
    for of in ROBUST.values():
        for count in (1, 2, 3, 4, 7):
            np.testing.assert_array_equal(of(models(np.repeat(one[None], count, axis=0))), one)
        with pytest.raises(ValueError, match="at least one"):
            of({})


def test_the_rules_are_what_they_are_called() -> None:
    rows = np.array([[1.0, 5.0], [2.0, 4.0], [9.0, -7.0], [3.0, 3.0]])
    np.testing.assert_array_equal(rule("median", 0.25)(models(rows)), [2.5, 3.5])
    np.testing.assert_array_equal(rule("median", 0.25)(models(rows[:3])), [2.0, 4.0])
    np.testing.assert_array_equal(rule("trimmed-mean", 0.25)(models(rows)), [2.5, 3.5])
    np.testing.assert_array_equal(rule("trimmed-mean", 0.0)(models(rows)), rows.mean(axis=0))
    np.testing.assert_array_equal(rule("krum", 0.25)(models(rows)), [1.0, 5.0])  # as near as [3, 3]: the smaller
    assert [suspects(n, 0.2) for n in (1, 2, 3, 5, 10, 20)] == [0, 0, 1, 1, 2, 4]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 2 * ABSURD, -1e30])
def test_a_model_that_is_no_model_is_refused_and_the_others_are_averaged(bad: float) -> None:
    rows = np.ones((4, 3))
    rows[2, 1] = bad
    kept, refused = usable(mail(rows))
    assert refused == [2]
    np.testing.assert_array_equal(fedavg({uav: model for uav, (model, _) in kept.items()}), [1.0, 1.0, 1.0])
    assert usable(mail(np.full((2, 3), ABSURD / 2)))[1] == []


def false_swarm(*extra: str) -> tuple[str, ...]:
    return ("uavs=10", "federation.fraction=1.0", "federation.byzantine_fraction=0.2", *extra)


def test_which_uavs_are_false_is_drawn_from_the_seed_and_never_the_leader() -> None:
    for seed in range(20):
        of = load(None, [*false_swarm(f"seed={seed}", "federation.leader=4")], method="mfgfl-h")
        chosen = Byzantine(of).uavs
        assert len(chosen) == 2
        assert 4 not in chosen
        np.testing.assert_array_equal(chosen, Byzantine(of).uavs)
    assert len({tuple(Byzantine(load(None, [*false_swarm(f"seed={s}")])).uavs) for s in range(9)}) > 1
    assert not len(Byzantine(load(None)).uavs)


@pytest.mark.parametrize("bits", [16, 32, 64])
@pytest.mark.parametrize("kind", ["huge", "sign-flip", "noise"])
def test_a_false_upload_is_false_finite_and_the_same_however_the_swarm_is_cut(kind: str, bits: int) -> None:
    settings_ = false_swarm(f"federation.byzantine_kind={kind}", f"radio.bits_per_float={bits}", "duration=7")
    summaries = [Lab(scenario(*settings_), uavs_per_node=rows).fly() for rows in (1, None)]
    assert summaries[0]["trajectory_sha256"] == summaries[1]["trajectory_sha256"]
    honest = Lab(scenario("uavs=10", "federation.fraction=1.0", f"radio.bits_per_float={bits}", "duration=7")).fly()
    refused = kind == "huge" and bits > 16  # the largest half-precision number is not absurd: that mean is a disaster
    assert summaries[0]["uploads_refused"] == (3 * 2 if refused else 0)
    assert honest["rounds"] == 3
    assert summaries[0]["rounds"] == (1 if kind == "huge" and not refused else 3)
    assert summaries[0]["trajectory_sha256"] != honest["trajectory_sha256"]
    assert honest["uploads_refused"] == 0


@pytest.mark.parametrize(
    ("payload", "kind"), [("float16", "huge"), ("int8", "huge"), ("int8", "sign-flip"), ("int8", "noise")]
)
def test_a_false_upload_is_false_in_a_narrow_payload_too(payload: str, kind: str) -> None:
    narrow = (f"federation.payload={payload}", "duration=7")
    settings_ = false_swarm(f"federation.byzantine_kind={kind}", *narrow)
    summaries = [Lab(scenario(*settings_), uavs_per_node=rows).fly() for rows in (1, None)]
    assert summaries[0]["trajectory_sha256"] == summaries[1]["trajectory_sha256"]
    honest = Lab(scenario("uavs=10", "federation.fraction=1.0", *narrow)).fly()
    assert summaries[0]["trajectory_sha256"] != honest["trajectory_sha256"]
    assert summaries[0]["uploads_refused"] == (3 * 2 if kind == "huge" and payload == "int8" else 0)
    assert summaries[0]["dropped_messages"] == {}


@pytest.mark.parametrize("name", ["median", "krum"])
def test_robust_rules_withstand_noise_in_bytes_as_they_do_in_floats(name: str) -> None:
    in_bytes = ("duration=15", "radio.target_snr_db=70", "federation.payload=int8", "federation.byzantine_kind=noise")
    honest = Lab(scenario("uavs=10", "federation.fraction=1.0", "federation.byzantine_fraction=0", *in_bytes))
    honest.fly()
    off = {}
    for aggregation in ("fedavg", name):
        lab = Lab(scenario(*false_swarm(*in_bytes, f'federation.aggregation="{aggregation}"')))
        lab.fly()
        off[aggregation] = float(np.abs(lab.world.flight.states - honest.world.flight.states).max())
    assert off[name] < off["fedavg"] / 2


def test_with_robust_aggregation_a_fifth_of_noise_disturbs_the_flight_less_than_with_the_mean() -> None:
    noise = ("duration=20", "federation.byzantine_kind=noise", "radio.target_snr_db=70")
    honest = Lab(scenario("uavs=10", "federation.fraction=1.0", "federation.byzantine_fraction=0", *noise))
    honest.fly()
    off = {}
    for name in ("fedavg", *ROBUST):
        lab = Lab(scenario(*false_swarm(*noise, f'federation.aggregation="{name}"')))
        lab.fly()
        off[name] = float(np.abs(lab.world.flight.states - honest.world.flight.states).max())
    assert max(off["median"], off["trimmed-mean"], off["krum"]) < off["fedavg"] / 2


def test_refused_uploads_are_an_event_that_names_their_uavs() -> None:
    lab = Lab(scenario(*false_swarm("federation.byzantine_kind=huge")))
    lab.fly()
    false = ", ".join(map(str, Byzantine(lab.world._scenario).uavs))
    texts = {event.text for event in lab.record.events if event.kind == "refused"}
    assert texts == {f"uploads of UAV {false} were not averaged"}
