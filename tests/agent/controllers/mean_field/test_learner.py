"""Rows are independent to the last bit: what a UAV learns does not depend on who shares its process."""

import numpy as np
import pytest

from meanflock.agent.controllers.mean_field.learner import Learner
from meanflock.swarm import state
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario, load
from tests.methods import LEARNING

TICKS = 4
Stepped = tuple[np.ndarray, np.ndarray]  # weights and numbers after a tick


def scenario(method: str, uavs: int = 8) -> Scenario:
    return load(None, [f"uavs={uavs}"], method=method)


def flight(rows: int, seed: int) -> np.ndarray:
    """States of `rows` UAVs over a few ticks, all over the box and beyond the destination, `(T, rows, 4)`."""
    draw = np.random.default_rng(seed)
    states = draw.uniform([-50, -50, -8, -8], [180, 130, 8, 8], (rows, state.SIZE))
    states[0] = 0.0  # r = 0, where the local cost is undefined
    return (
        states + 0.3 * draw.standard_normal((TICKS, rows, state.SIZE)).cumsum(axis=0) * (np.arange(rows) > 0)[:, None]
    )


def learner_of(flown: Scenario) -> Learner:
    return Learner(flown, learns_density=flown.method != "hjb")


def known_of(method: str, rows: int, seed: int) -> np.ndarray | None:
    if method != "hjb":
        return None
    return np.random.default_rng(seed).normal(0, 30, (TICKS, rows, 8, state.SIZE))


def learn(
    flown: Scenario, states: np.ndarray, known: np.ndarray | None, rows: np.ndarray
) -> tuple[list[Stepped], np.ndarray]:
    """Some rows of a flight, learned together."""
    learner = learner_of(flown)
    weights = learner.init(len(rows), starts(flown))
    outcomes = []
    for tick in range(TICKS):
        outcome = learner.step(weights, states[tick][rows], None if known is None else known[tick][rows])
        outcomes.append(outcome)
        weights = outcome[0]
    return outcomes, weights


def bits(outcomes: list[Stepped], row: int) -> bytes:
    """Everything a row came to, as bytes."""
    return b"".join(numbers[row].tobytes() + weights[row].tobytes() for weights, numbers in outcomes)


@pytest.mark.parametrize("rows", [1, 2, 5, 25, 64])
@pytest.mark.parametrize("method", LEARNING)
def test_rows_together_learn_what_each_learns_alone(method: str, rows: int) -> None:
    flown, states, known = scenario(method), flight(rows, rows), known_of(method, rows, rows)
    together, weights = learn(flown, states, known, np.arange(rows))
    assert np.isfinite(weights).all()
    for row in sorted({0, 1, rows // 2, rows - 2, rows - 1, *range(0, rows, 7)} & set(range(rows))):
        alone, _ = learn(flown, states, known, np.array([row]))
        assert bits(alone, 0) == bits(together, row)


@pytest.mark.parametrize("method", ["hjb", "mfgfl-hf"])
@pytest.mark.parametrize("seed", range(5))
def test_neither_the_order_of_the_rows_nor_the_company_they_keep_matters(method: str, seed: int) -> None:
    rows = 13
    flown, states, known = scenario(method), flight(rows, seed), known_of(method, rows, seed)
    together, _ = learn(flown, states, known, np.arange(rows))
    chosen = np.random.default_rng(seed).permutation(rows)[:9]
    other, _ = learn(flown, states, known, chosen)
    for place, row in enumerate(chosen):
        assert bits(other, place) == bits(together, row)


@pytest.mark.parametrize("method", ["hjb", "mfgfl-hf"])
def test_a_row_that_diverges_leaves_the_others_as_they_were(method: str) -> None:
    flown, states, known = scenario(method), flight(6, 1), known_of(method, 6, 1)
    honest, _ = learn(flown, states, known, np.arange(6))
    states[1:, 2] = 1e9
    states[2:, 4] = np.nan
    with np.errstate(all="ignore"):
        disturbed, _ = learn(flown, states, known, np.arange(6))
    for row in (0, 1, 3, 5):
        assert bits(disturbed, row) == bits(honest, row)


def test_a_step_changes_none_of_its_arguments() -> None:
    for method in ("hjb", "mfg"):
        flown, states, known = scenario(method), flight(5, 2), known_of(method, 5, 2)
        learner = learner_of(flown)
        weights = learner.init(5, starts(flown))
        weights = learner.step(weights, states[0], None if known is None else known[0])[0]
        before = weights.copy(), states.copy(), None if known is None else known.copy()
        learner.step(weights, states[1], None if known is None else known[1])
        np.testing.assert_array_equal(weights, before[0])
        np.testing.assert_array_equal(states, before[1])
        if known is not None:
            np.testing.assert_array_equal(known, before[2])


def test_states_that_may_not_be_written_to_are_enough() -> None:
    flown, states = scenario("mfg"), flight(3, 3)
    states.flags.writeable = False
    learn(flown, states, None, np.arange(3))
    learner = learner_of(flown)
    learner.step(learner.init(3, starts(flown)), states[0], None)
