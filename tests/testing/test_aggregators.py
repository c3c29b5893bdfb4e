"""The suite for aggregation rules accepts rules in swarms of all sizes, and rejects each kind of mistake."""

from typing import Any

import numpy as np
import pytest

from meanflock.federation.rules.base import Aggregator, State, Uploads
from meanflock.swarm.scenario import Scenario
from meanflock.testing import ConformanceError, check_aggregator
from tests.testing.good import GoodAggregator, changed, failing


class HasARowForEachUav(GoodAggregator):
    """Remembers the last upload of every UAV of the swarm."""

    def init(self, parameters: int) -> State:
        return {"last": np.zeros((self.scenario.uavs, parameters))}

    def step(self, state: State, uploads: Uploads) -> tuple[State, np.ndarray]:
        last = state["last"].copy()
        last[uploads.uavs] = uploads.models
        return {"last": last}, last.mean(axis=0)


@pytest.mark.parametrize("uavs", [1, 4, 25, 60])
@pytest.mark.parametrize("good", [GoodAggregator, HasARowForEachUav])
def test_a_good_rule_conforms_in_swarms_of_all_sizes(good: type[Aggregator], uavs: int) -> None:
    check_aggregator(good, scenario=Scenario(uavs=uavs))


def changed_model(change: Any) -> Any:
    """A rule whose model is `change(model, models)`."""
    return changed(
        GoodAggregator,
        "step",
        lambda _self, answer, _state, uploads: (answer[0], change(answer[1], uploads.models)),
    )


def changed_state(change: Any) -> Any:
    """A rule whose state is `change(state, round)`."""
    return changed(
        GoodAggregator,
        "step",
        lambda _self, answer, _state, uploads: (change(answer[0], uploads.round), answer[1]),
    )


def writes_to_the_models(_self: Any, answer: Any, _state: Any, uploads: Uploads) -> Any:
    uploads.models[:] *= 2.0
    return answer


def writes_to_the_state(_self: Any, answer: Any, state: Any, *_: Any) -> Any:
    state["last"] += 1.0
    return answer


WRONG: dict[str, tuple[Any, str]] = {
    "writes to the models": (
        changed(GoodAggregator, "step", writes_to_the_models),
        "writes to an array .*; .*copy before you write",
    ),
    "writes to the state": (
        changed(GoodAggregator, "step", writes_to_the_state),
        "writes to an array .*; .*copy before you write",
    ),
    "a model of another shape": (
        changed_model(lambda model, _: model[:-1]),
        r"a model of shape \(11,\), expected \(12,\); return one model",
    ),
    "a model that is not finite": (changed_model(lambda model, _: model * np.nan), "model is not finite; guard"),
    "a model of complex numbers": (
        changed_model(lambda model, _: model.astype(complex)),
        "the model is complex128; return float64",
    ),
    "needs two models": (
        changed_model(lambda model, models: models[1]),
        "`step` with 1 model failed: IndexError.*; any number from one on must do",
    ),
    "weights of another mean": (
        type("Wrong", (GoodAggregator,), {"weights": lambda _self, uploads: np.ones(len(uploads.models))}),
        "`step` is not the mean by `weights`; return None there",
    ),
    "fails at first": (
        failing(GoodAggregator, "init", OSError("no such table")),
        r"`init` failed: OSError: no such table .*; return a dict",
    ),
    "a state that grows": (
        changed_state(lambda state, number: {**state, f"round_{number}": state["last"]}),
        r"state has \['last', 'round_1'\]; of `init` it had .*; begin with all names, and keep",
    ),
    "a state that is not finite": (
        changed_state(lambda state, _: {"last": state["last"] + np.inf}),
        r"state\['last'\] is not finite; guard divisions",
    ),
    "a state of texts": (
        type("Wrong", (GoodAggregator,), {"init": lambda *_: {"who": np.array(["me"])}}),
        r"state\['who'\] is <U2 \(1,\); a checkpoint keeps arrays of bool,",
    ),
}


@pytest.mark.parametrize(("wrong", "expected"), WRONG.values(), ids=WRONG)
def test_a_wrong_rule_is_rejected_with_its_mistake(wrong: type[Aggregator], expected: str) -> None:
    with pytest.raises(ConformanceError, match=f"^Wrong: .*{expected}"):
        check_aggregator(wrong)
