"""The learners' kernels: exact derivatives, closed forms of sums; both forms give the same bits, row by row."""

import json
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from meanflock.agent.controllers.mean_field.learner import MeanFieldLearner, density_exponents, tables, value_exponents
from meanflock.kernels import reference
from meanflock.kernels.mean_field import features, fpk, hjb, layout
from meanflock.kernels.mean_field.layout import Tables, packed
from meanflock.kernels.mean_field.separation import FARTHEST, decay
from meanflock.swarm import state
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import load

LANES = 8  # as many rows as any machine steps at once, or more
WIDE = 1003  # as many as are stepped with AVX-512, and some that fill no vector
SCENARIO = load(None, ["uavs=9"], method="mfg")
TABLES = tables(SCENARIO)
MULTINOMIAL = tables(load(None, ["uavs=9", "learner.multinomial=true"], method="mfg"))
IN_SPACE = tables(load(None, ["uavs=9", "space.dimensions=3", "wind.mean=[1,-1,0.5]"], method="mfg"))
SPACE = layout.layout_of(3)
AROUND = ("density", "known", "given")  # where φ_G comes from


def tick(
    backend: ModuleType, weights: np.ndarray, states: np.ndarray, around: np.ndarray | None, tables_: Tables = TABLES
) -> list[bytes]:
    """The bits of each row: its weights and its numbers; a NaN is a NaN, its sign and payload mean nothing."""
    stepped, numbers = np.full_like(weights, 7.0), np.full((len(weights), 3 + states.shape[1] // 2), 7.0)
    with np.errstate(all="ignore"):
        backend.learn(backend.prepare(tables_), states, weights, around, stepped, numbers)
    whole = np.concatenate([stepped, numbers], axis=-1)
    return [row.tobytes() for row in np.where(np.isnan(whole), np.nan, whole)]


def flying(around: str, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Rows as different as those of a swarm on its way."""
    draw = np.random.default_rng(rows)
    weights = MeanFieldLearner(SCENARIO).init(rows, starts(SCENARIO)) + draw.normal(0, 0.1, (rows, layout.MODEL_FLOATS))
    states = draw.uniform([-50, -50, -8, -8], [180, 130, 8, 8], (rows, 4))
    known = draw.normal(0, 30, (rows, 300, 4))
    return weights, states, {"density": None, "known": known, "given": draw.uniform(0, 9, rows)}[around]


any_number = st.floats(allow_nan=True, allow_infinity=True, width=64)


@settings(max_examples=60, deadline=None)
@given(
    arrays(np.float64, (3, layout.MODEL_FLOATS), elements=any_number),
    arrays(np.float64, (3, 4), elements=any_number),
    arrays(np.float64, (3, 9, 4), elements=any_number),
)
def test_both_forms_give_the_same_bits_for_any_numbers(
    weights: np.ndarray, states: np.ndarray, known: np.ndarray
) -> None:
    compiled = pytest.importorskip("meanflock.kernels.compiled")
    for around in (None, known, known[:, 0, 0].copy()):
        for tables_ in (TABLES, MULTINOMIAL):
            three = tick(reference, weights, states, around, tables_)
            assert tick(compiled, weights, states, around, tables_) == three
        few = (weights, states, around)
        many = (None if array is None else np.resize(array, (WIDE, *array.shape[1:])) for array in few)
        assert tick(compiled, *many, MULTINOMIAL) == [three[k % 3] for k in range(WIDE)]


@pytest.mark.parametrize("around", AROUND)
@pytest.mark.parametrize("rows", [1, 3, LANES + 1, WIDE])
def test_both_forms_give_the_same_bits_in_space_row_by_row(backend: ModuleType, around: str, rows: int) -> None:
    draw = np.random.default_rng(rows)
    weights = draw.normal(0, 0.3, (9, SPACE.floats))
    states = draw.uniform([-50, -50, -9, -8, -8, -3], [180, 130, 9, 8, 8, 3], (9, 6))
    states[8], weights[7, 3] = np.nan, np.inf
    given = {"density": None, "known": draw.normal(0, 30, (9, 20, 6)), "given": draw.uniform(0, 9, 9)}[around]
    alone = [
        tick(reference, *(None if part is None else part[k : k + 1] for part in (weights, states, given)), IN_SPACE)[0]
        for k in range(9)
    ]
    many = [None if part is None else np.resize(part, (rows, *part.shape[1:])) for part in (weights, states, given)]
    assert tick(backend, *many, IN_SPACE) == [alone[k % 9] for k in range(rows)]


def test_the_layout_in_space_follows_from_that_in_the_plane() -> None:
    assert layout.layout_of(2)[1:4] == (54, 69, 15)
    assert SPACE[1:4] == (81, 209, 35)
    assert SPACE.floats == 580
    assert len(value_exponents(3)) == 81
    assert len(density_exponents(3)) == 209
    assert len(IN_SPACE.weight) == 1819


def test_a_level_state_has_the_features_and_the_interaction_of_the_plane() -> None:
    """With z = v_z = 0 and without weights of their terms, â_z is 0, and all else is that of the plane."""
    draw = np.random.default_rng(4)
    flat, weights = draw.uniform(-9, 9, (5, 4)), draw.normal(0, 0.1, (5, layout.MODEL_FLOATS))
    states, spread = np.zeros((5, 6)), np.zeros((5, SPACE.floats))
    states[:, [0, 1, 3, 4]] = flat
    level = [not (row[2] or row[5]) for row in density_exponents(3).tolist()]
    spread[:, SPACE.value] = np.concatenate(
        [weights[:, :54], np.zeros((5, 27)), weights[:, 54:108], np.zeros((5, 27))], 1
    )
    spread[:, SPACE.density][:, np.flatnonzero(level * 2)] = weights[:, layout.DENSITY]
    powers = features.powers(IN_SPACE, states)
    terms = features.terms(IN_SPACE, features.pairs(IN_SPACE, powers))
    np.testing.assert_array_equal(terms, features.density(IN_SPACE, states))
    there = features.density(TABLES, flat)
    np.testing.assert_allclose(terms[:, [True, *level]], there, rtol=1e-13)
    value = hjb.step(IN_SPACE, spread[:, SPACE.value], states, powers, np.zeros(5))
    plane = hjb.step(TABLES, weights[:, layout.VALUE], flat, features.powers(TABLES, flat), np.zeros(5))
    np.testing.assert_allclose(value.action_before[:, :2], plane.action_before, rtol=1e-12)
    np.testing.assert_allclose(value.action_before[:, 2], 0.0, atol=1e-12)


def test_derivatives_of_pairs_in_space_are_exact() -> None:
    draw = np.random.default_rng(2)
    states, step = draw.uniform(-30, 30, (6, 6)), 1e-4

    def pairs(at: np.ndarray) -> np.ndarray:
        return features.pairs(IN_SPACE, features.powers(IN_SPACE, at))

    here = pairs(states)
    for axis in range(6):
        ahead, behind = states.copy(), states.copy()
        ahead[:, axis] += step
        behind[:, axis] -= step
        of, first = (0, 1 + axis) if axis < 3 else (4, 2 + axis)
        slope = (pairs(ahead) - pairs(behind))[:, of] / (2 * step)
        np.testing.assert_allclose(here[:, first], slope, rtol=1e-6, atol=1e-9)
        if axis >= 3:
            bend = (pairs(ahead)[:, first] - pairs(behind)[:, first]) / (2 * step)
            np.testing.assert_allclose(here[:, 5 + axis], bend, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("around", AROUND)
@pytest.mark.parametrize("rows", [0, 1, 2, LANES - 1, LANES, LANES + 1, 2 * LANES + 1])
def test_rows_are_those_of_numpy_one_by_one_and_nothing_beyond_the_last_is_touched(
    backend: ModuleType, around: str, rows: int
) -> None:
    """The arrays given are the beginnings of longer ones, which hold what would show."""
    weights, states, known = flying(around, 2 * LANES + 2)
    each = [slice(k, k + 1) for k in range(rows)]
    alone = [tick(reference, weights[k], states[k], None if known is None else known[k])[0] for k in each]
    for array in (states, weights, *([] if known is None else [known])):
        array[rows:] = np.nan
    stepped, numbers = np.full((2 * LANES + 2, layout.MODEL_FLOATS), 7.0), np.full((2 * LANES + 2, 5), 7.0)
    part = None if known is None else known[:rows]
    backend.learn(backend.prepare(TABLES), states[:rows], weights[:rows], part, stepped[:rows], numbers[:rows])
    assert [row.tobytes() for row in np.concatenate([stepped, numbers], axis=-1)[:rows]] == alone
    assert (stepped[rows:] == 7.0).all()
    assert (numbers[rows:] == 7.0).all()


@pytest.mark.parametrize("field", Tables._fields[Tables._fields.index("value_first") :])
@pytest.mark.parametrize("bad", [-1, 10_000, -(2**31), 2**31 - 1])
def test_no_index_of_the_tables_points_outside(field: str, bad: int) -> None:
    native = pytest.importorskip("meanflock.kernels._native")
    for tables_ in (TABLES, IN_SPACE):
        for place in (0, -1)[: len(getattr(tables_, field))]:
            changed = np.array(getattr(tables_, field))
            changed[place] = bad
            with pytest.raises(ValueError, match="outside"):
                native.tables(*packed(tables_._replace(**{field: changed})))


def test_tables_of_another_size_or_type_are_refused() -> None:
    native = pytest.importorskip("meanflock.kernels._native")
    for place, array in enumerate(both := packed(TABLES)):
        for wrong in (array[:-1], np.append(array, array[:1]), array.astype(np.int64)):
            with pytest.raises(ValueError, match="expected"):
                native.tables(*both[:place], wrong, *both[place + 1 :])


def test_weights_of_a_step_stay_as_long_as_somebody_has_them() -> None:
    learner = MeanFieldLearner(SCENARIO)
    _, states, _ = flying("density", 9)
    weights = [learner.init(9, starts(SCENARIO))]
    for _ in range(4):
        weights.append(learner.step(weights[-1], states, None)[0])
    part = weights.pop()[:, layout.VALUE]  # a view keeps the whole
    kept = [array.copy() for array in (part, *weights)]
    for _ in range(4):
        learner.step(weights[-1], states, None)
    assert all(np.array_equal(array, copy) for array, copy in zip((part, *weights), kept, strict=True))


def pushed(backend: ModuleType, states: np.ndarray, known: np.ndarray, weight: float, range_m: float) -> np.ndarray:
    result = np.full((len(states), 2), 7.0)
    backend.repel(states, known, weight, range_m, result)
    return result


def test_the_decay_is_an_exponential() -> None:
    u = np.concatenate([np.linspace(0.0, FARTHEST, 20_001), [1e-300, math.log(2) / 2]])
    np.testing.assert_allclose(decay(u), np.exp(-u), rtol=4e-16, atol=0)
    assert (decay(np.array([FARTHEST + 1e-9, 1e300, np.inf, np.nan])) == 0.0).all()
    assert decay(np.zeros(1)) == 1.0


def test_two_uavs_that_meet_are_pushed_apart_alike(backend: ModuleType) -> None:
    """By w d exp(−d²/2ℓ²) each, along the line between them, whatever their velocities; nobody pushes itself."""
    states = np.array([[0.0, 0.0, 3.0, 1.0], [0.3, 0.4, -2.0, 0.0]])
    both = pushed(backend, states, np.repeat(states[None], 2, axis=0), 5.0, 0.5)
    np.testing.assert_allclose(both[1], 5.0 * np.array([0.3, 0.4]) * math.exp(-0.5), rtol=1e-15)
    np.testing.assert_array_equal(both[0], -both[1])
    alone = pushed(backend, states, states[:, None], 5.0, 0.5)
    np.testing.assert_array_equal(alone, 0.0)


@settings(max_examples=100, deadline=None)
@given(
    arrays(np.float64, (2, 4), elements=any_number),
    arrays(np.float64, (2, 9, 4), elements=any_number),
    st.sampled_from([0, 1, 7, 129, 300]),
    st.sampled_from([0.05, 0.5, 40.0]),
)
def test_both_forms_give_the_same_finite_bits_for_any_numbers(
    states: np.ndarray, known: np.ndarray, others: int, range_m: float
) -> None:
    compiled = pytest.importorskip("meanflock.kernels.compiled")
    near = np.random.default_rng(others).normal(0, 1.0, (9, 4 * others + 4))
    for given_ in ((states, known), (near[:, :4].copy(), near[:, 4:].reshape(9, others, 4).copy())):
        first, second = (pushed(backend, *given_, 5.0, range_m) for backend in (compiled, reference))
        assert first.tobytes() == second.tobytes()
        assert np.isfinite(first).all()


ORACLE = json.loads((Path(__file__).parents[2] / "oracle" / "learner.json").read_text())
CASES = range(len(ORACLE["cases"]))
RTOL = 1e-9
KEYS = {  # of the scenario, with the names of the oracle
    **{"learner.position_scale": "L_r", "learner.velocity_scale": "L_v", "learner.mu_h": "mu_H"},
    **{"learner.mu_f": "mu_F", "learner.c_h": "c_H", "learner.kappa": "kappa"},
    **{"cost.c1": "c1", "cost.c2": "c2", "cost.c3": "c3", "destination.radius": "s_dest"},
    **{"wind.sigma": "sigma_wind", "wind.drag": "c0", "wind.mean": "v_o"},
}


OF_ORACLE = tables(load(None, [f"{key}={ORACLE['parameters'][name]}" for key, name in KEYS.items()]))


def rows(name: str) -> np.ndarray:
    return np.array([ORACLE["cases"][i][name] for i in CASES], dtype=float)


def close(actual: Any, name: str) -> None:
    np.testing.assert_allclose(actual, rows(name), rtol=RTOL, atol=0, err_msg=name)


def test_exponents_are_in_the_agreed_order() -> None:
    assert value_exponents(2).tolist() == ORACLE["exponents_H"]
    assert density_exponents(2).tolist() == ORACLE["exponents_F"]


def weights(first: str, second: str) -> np.ndarray:
    return np.concatenate([rows(first), rows(second)], axis=-1)


def test_a_tick_of_either_form_under_the_oracle_s_interaction(backend: ModuleType) -> None:
    models = np.concatenate([weights("w_H0", "w_H1"), weights("w_F0", "w_F1")], axis=-1)
    stepped, numbers = np.empty_like(models), np.empty((len(CASES), 5))
    backend.learn(backend.prepare(OF_ORACLE), rows("state"), models, rows("phi_G"), stepped, numbers)
    close(numbers[:, :2], "action_after")
    close(numbers[:, 2], "e_H")
    close(stepped[:, :54], "w_H0_next")
    close(stepped[:, 54:108], "w_H1_next")
    np.testing.assert_array_equal(numbers[:, 3], 0.0)
    np.testing.assert_array_equal(numbers[:, 4], rows("phi_G"))
    np.testing.assert_array_equal(stepped[:, layout.DENSITY], models[:, layout.DENSITY])


def test_density_features_and_step() -> None:
    t, states = OF_ORACLE, rows("state")
    powers = features.powers(t, states)
    after = hjb.step(t, weights("w_H0", "w_H1"), states, powers, rows("phi_G"))
    close(hjb.lyapunov_rate(t, states, hjb.drift(t, states, after.action_before)), "L_s_dot")
    pairs = features.pairs(t, powers)
    sigma = features.terms(t, pairs)[:, 1:]
    close(sigma, "sigma_F")
    close(fpk.divergence(t, after.curvature), "drift_divergence")
    drift = hjb.drift(t, states, after.action)
    stepped, residual = fpk.step(t, weights("w_F0", "w_F1"), states, pairs, sigma, drift, after.curvature)
    close(residual, "e_F")
    close(stepped[:, :69], "w_F0_next")
    close(stepped[:, 69:], "w_F1_next")


SCALES = ["learner.position_scale=300", "learner.velocity_scale=60"]
PRINTED = load(None, ["uavs=9", "learner.multinomial=true", *SCALES], method="mfg")
T = tables(PRINTED)
STATES = np.random.default_rng(2).uniform([-50, -50, -8, -8], [180, 130, 8, 8], (13, 4))
SCALED = STATES / [300.0, 300.0, 60.0, 60.0]


def test_the_value_s_features_of_an_axis_add_up_to_the_sixth_power() -> None:
    """(1 + r̄ + v̄)⁶ − 1, and its derivatives by r, v and v twice."""
    values = features.value(T, features.powers(T, STATES)).sum(axis=-1)  # (13, 4, 2)
    base = 1.0 + state.position(SCALED) + state.velocity(SCALED)
    for k, expected in enumerate((base**6 - 1.0, 6 * base**5 / 300, 6 * base**5 / 60, 30 * base**4 / 60**2)):
        np.testing.assert_allclose(values[:, k], expected, rtol=1e-12)


def test_the_density_s_terms_add_up_to_the_fourth_power() -> None:
    values = features.density(T, STATES)
    np.testing.assert_array_equal(values, features.terms(T, features.pairs(T, features.powers(T, STATES))))
    np.testing.assert_allclose(values.sum(axis=-1), (1.0 + SCALED.sum(axis=-1)) ** 4, rtol=1e-12)
