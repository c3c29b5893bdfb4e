"""A few false uploads: what each rule of aggregation withstands, and which models the leader does not average."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from meanflock.federation.byzantine import Byzantine
from meanflock.federation.rules.base import Uploads
from meanflock.federation.rules.robust import suspects
from meanflock.swarm import plugins
from meanflock.swarm.scenario import load
from tests.faults.conftest import Lab, scenario

ROBUST = ("median", "trimmed-mean", "krum")


def average(rule: str, models: np.ndarray, tolerance: float = 0.25) -> np.ndarray:
    instance = plugins.create("aggregator", rule, {}, load(None, [f"federation.tolerance={tolerance}"]))
    state, model = instance.step(instance.init(0), Uploads.complete(models.astype(np.float64)))
    assert not state
    return np.asarray(model)


@pytest.mark.parametrize("rule", ROBUST)
def test_a_fifth_of_false_uploads_moves_no_weight_out_of_the_honest_range_in_any_order(rule: str) -> None:
    @settings(max_examples=60, database=None)
    @given(
        hnp.arrays(np.float64, (8, 3), elements=st.floats(-1, 1)),
        hnp.arrays(np.float64, (2, 3), elements=st.floats(-1e8, 1e8)),
        st.permutations(range(10)),
    )
    def check(honest: np.ndarray, false: np.ndarray, order: list[int]) -> None:
        models = np.concatenate([honest, false])
        averaged = average(rule, models)
        assert average(rule, models[order]).tobytes() == averaged.tobytes()
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
        of = load(None, [*false_swarm(f"seed={seed}", "federation.leader=4")], method="mfgfl-h")
        chosen = Byzantine(of).uavs
        assert len(chosen) == 2
        assert 4 not in chosen
        np.testing.assert_array_equal(chosen, Byzantine(of).uavs)
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
    false = ", ".join(map(str, Byzantine(lab.world._scenario).uavs))
    texts = {event.text for event in lab.record.events if event.kind == "refused"}
    assert texts == ({f"uploads of UAV {false} were not averaged"} if refused else set())
