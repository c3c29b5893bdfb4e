"""The conformance suite of aggregation rules."""

from typing import Any

import msgspec
import numpy as np

from meanflock.federation.rules.base import Aggregate, Aggregator, State, Uploads
from meanflock.swarm import threads
from meanflock.swarm.errors import FAILURES, last_line
from meanflock.swarm.plugins.guard import check_bounded
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.control import decode_record, encode_record
from meanflock.testing.error import (
    GONE,
    OTHER_THREADS,
    THREADS,
    alike,
    asked,
    check_class,
    check_kept,
    check_same_form,
    copies,
    fail,
    make,
    same,
    with_surroundings,
)
from meanflock.testing.pace import SLOW_MS, check_pace

PARAMETERS = 12
UPLOADS = (2, 1, 3, 5, 1, 7)  # uploads of each round, if the swarm has so many UAVs; then a round of all UAVs
SWARM, MODEL = 25, 216  # of the paper, to measure the time of a round
_RANDOM = "draw nothing from global generators; mf.seeds.generator makes one of the scenario's seed"


@threads.limited()
def check_aggregator(
    aggregator: type[Aggregator],
    options: dict[str, Any] | None = None,
    scenario: Scenario | None = None,
    slow_ms: float = SLOW_MS,
    parameters: int | None = None,
) -> None:
    """Runs rounds of one upload, of several and of the whole swarm, and checks everything that a federation relies on.

    Args:
        aggregator: the class. options: those of the table [federation.options]. scenario: default: the paper's.
        slow_ms: limit of the median time of a round of 25 models, or of all UAVs if there are fewer. parameters: floats
            of a model, for a rule that is made for one size; None: 12, and 216 to measure the time.

    Raises:
        ConformanceError: a check fails; the text says what to fix.
    """
    check_class(aggregator, "aggregator")
    flown = msgspec.structs.replace(scenario or Scenario(), federation=Scenario().federation)
    options = options or {}
    size = PARAMETERS if parameters is None else parameters

    def rounds(seed: int, afresh: bool = False, number: int = 1) -> tuple[list[np.ndarray], State]:
        draw = np.random.default_rng(5)

        def run() -> tuple[list[np.ndarray], State]:
            rule: Aggregator = make(aggregator, options, flown)
            begun = _begun(rule, size)
            averaged: list[np.ndarray] = []
            state = begun
            for number, count in enumerate((*UPLOADS, flown.uavs), 1):
                uavs = np.sort(draw.choice(flown.uavs, min(count, flown.uavs), replace=False))
                models = draw.standard_normal((len(uavs), size))
                uploads = Uploads.complete(models, number, uavs)
                if afresh:
                    rule, state = make(aggregator, options, flown), decode_record(encode_record(state))
                given = [models, uavs, uploads.sent, *state.values()]
                before = copies(given)
                try:
                    answer = rule.step(state, uploads)
                    weights = rule.weights(uploads)
                except FAILURES as error:
                    problem = f"`step` with {len(uavs)} model{'s' * (len(uavs) > 1)} failed: {last_line(error)}"
                    fail(aggregator, problem, GONE if afresh else "any number from one on must do")
                if not isinstance(answer, tuple) or len(answer) != 2:
                    fail(aggregator, f"`step` returns a {type(answer).__name__}", "return the state and the model")
                state, returned = answer
                model = returned.model if isinstance(returned, Aggregate) else returned
                check_kept(aggregator, "state", state)
                if not rule.state_bytes:
                    check_same_form(aggregator, "state", state, begun)
                if not all(same(one, other) for one, other in zip(before, given, strict=True)):
                    fail(
                        aggregator, "`step` writes to an array it was given", "return new arrays; copy before you write"
                    )
                if model is None:  # the rule waits for more uploads
                    averaged.append(np.zeros(0))
                    continue
                if np.shape(model) != (size,):
                    expected = f"expected {(size,)}"
                    fail(
                        aggregator, f"`step` returns a model of shape {np.shape(model)}, {expected}", "return one model"
                    )
                try:
                    check_bounded("the model", np.asarray(model))
                except ValueError as error:
                    fail(aggregator, str(error), "such a model is not broadcast; guard divisions and empty sums")
                if not np.can_cast(np.asarray(model).dtype, np.float64, "same_kind"):
                    fail(aggregator, f"the model is {np.asarray(model).dtype}", "return float64")
                if weights is not None and not _is_mean(model, models, weights):
                    fail(aggregator, "`step` is not the mean by `weights`", "return None there, or the weights of step")
                averaged.append(np.asarray(model))
            return averaged, state

        return with_surroundings(aggregator, _RANDOM, run, seed, number)

    first, state = rounds(1)
    for again, problem, remedy in (
        (rounds(2), "the same rounds differed in a second run", _RANDOM),
        (rounds(1, number=OTHER_THREADS), *THREADS),
        (rounds(1, afresh=True), "rounds that continue from a checkpoint differ", "keep all you remember in the state"),
    ):
        models, after = again
        if not all(same(one, other) for one, other in zip(first, models, strict=True)) or alike(state, after):
            fail(aggregator, problem, remedy)

    rule: Aggregator = make(aggregator, options, flown)
    size = MODEL if parameters is None else parameters
    rule_state, uavs = _begun(rule, size), np.arange(min(SWARM, flown.uavs))
    many = np.random.default_rng(6).standard_normal((len(uavs), size))

    def average(number: int) -> None:
        nonlocal rule_state
        rule_state, _ = rule.step(rule_state, Uploads.complete(many, number, uavs))

    check_pace(aggregator, f"a round of {len(uavs)} models", slow_ms, average)


def _is_mean(model: np.ndarray, models: np.ndarray, weights: Any) -> bool:
    """Returns whether a model is the weighted mean of models (S, L), within rounding."""
    if np.shape(weights) != (len(models),) or not (np.asarray(weights) > 0.0).all():
        return False
    return bool(np.allclose(model, np.average(models, axis=0, weights=weights), rtol=1e-9, atol=1e-12))


def _begun(rule: Aggregator, parameters: int) -> State:
    """Initial state of a rule."""
    state = asked(type(rule), rule.init, parameters, remedy="return a dict of arrays")
    check_kept(type(rule), "state", state)
    return state
