"""The suite for aggregation rules lets ours through, and says of every kind of wrong one what to mend."""

import time

import numpy as np
import pytest

from meanflock.federation.rules.base import Aggregator, State
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Scenario
from meanflock.testing import ConformanceError, check_aggregator


@pytest.mark.parametrize("name", plugins.names("aggregator"))
def test_every_rule_of_ours_conforms(name: str) -> None:
    check_aggregator(plugins.load("aggregator", name))


class Good(Aggregator):
    """The mean with momentum, from which the wrong ones are made."""

    name = "good"

    def init(self, parameters: int) -> State:
        return {"last": np.zeros(parameters)}

    def step(self, state: State, models: np.ndarray, uavs: np.ndarray, round_: int) -> tuple[State, np.ndarray]:
        model = 0.5 * state["last"] + 0.5 * models.mean(axis=0)
        return {"last": model}, model


class HasARowForEachUav(Good):
    """Remembers the last upload of every UAV of the swarm."""

    name = "a-row-for-each"

    def init(self, parameters: int) -> State:
        return {"last": np.zeros((self.scenario.uavs, parameters))}

    def step(self, state: State, models: np.ndarray, uavs: np.ndarray, round_: int) -> tuple[State, np.ndarray]:
        (last := state["last"].copy())[uavs] = models
        return {"last": last}, last.mean(axis=0)


@pytest.mark.parametrize("uavs", [1, 4, 25, 60])
@pytest.mark.parametrize("good", [Good, HasARowForEachUav])
def test_a_good_one_conforms_in_swarms_of_all_sizes(good: type[Aggregator], uavs: int) -> None:
    check_aggregator(good, scenario=Scenario(uavs=uavs))


class DrawsItsOwn(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        after, model = super().step(state, models, uavs, round_)
        return after, model + np.random.normal(size=model.shape)  # noqa: NPY002  # that is what is wrong with it


class KeepsItElsewhere(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        self.rounds = getattr(self, "rounds", 0) + 1
        after, model = super().step(state, models, uavs, round_)
        return after, model * self.rounds


class WritesToTheModels(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        models *= 2.0
        return super().step(state, models, uavs, round_)


class WritesToTheState(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        state["last"] += 1.0
        return super().step(state, models, uavs, round_)


class OfAnotherShape(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        return state, models[0, :-1]


class NotFinite(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        return state, models.mean(axis=0) * np.nan


class NeedsThree(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        return state, models[2]


class NeedsTwo(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        if len(models) == 1:
            raise ValueError("one model is no average")
        return super().step(state, models, uavs, round_)


class Nameless(Good):
    name = ""


class Leaves(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        raise SystemExit(3)


class ReturnsTheModel(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        return models.mean(axis=0)


class CannotBegin(Good):
    def init(self, parameters):  # type: ignore[no-untyped-def]
        raise OSError("no such table")


class OfComplexNumbers(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        state, model = super().step(state, models, uavs, round_)
        return state, model.astype(complex)


class RemembersTexts(Good):
    def init(self, parameters):  # type: ignore[no-untyped-def]
        return {"last": np.zeros(parameters), "who": np.array(["me"])}


class RemembersMoreAndMore(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        return {**state, f"round_{round_}": models.mean(axis=0)}, models.mean(axis=0)


class RemembersNoNumber(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        return {"last": state["last"] + np.inf}, models.mean(axis=0)


@pytest.mark.parametrize(
    ("wrong", "says", "mend"),
    [
        (DrawsItsOwn, "otherwise a second time", "draw nothing from global generators"),
        (KeepsItElsewhere, "from a checkpoint differ", "keep all you remember in the state"),
        (WritesToTheModels, "writes to an array", "copy before you write"),
        (WritesToTheState, "writes to an array", "copy before you write"),
        (OfAnotherShape, r"a model of shape \(11,\), expected \(12,\)", "return one model"),
        (NotFinite, "not finite", "guard divisions"),
        (NeedsThree, "failed: IndexError", "any number from one on must do"),
        (NeedsTwo, "`step` with 1 model failed: ValueError: one model", "any number from one on must do"),
        (Nameless, "no `name`", "give it a name"),
        (Leaves, r"`step` with \d models failed: SystemExit: 3", "any number from one on must do"),
        (ReturnsTheModel, "`step` returns a ndarray", "return the state and the model"),
        (CannotBegin, r"`init` failed: OSError: no such table \(test_aggregators.py, line \d+\)", "return a dict"),
        (OfComplexNumbers, "the model is complex128", "return float64"),
        (RemembersMoreAndMore, r"state has \['last', 'round_1'\]; of `init` it had", "begin with all names, and keep"),
        (RemembersTexts, r"state\['who'\] is <U2 \(1,\)", "a checkpoint keeps arrays of bool,"),
        (RemembersNoNumber, r"state\['last'\] is not finite", "guard divisions"),
    ],
)
def test_a_wrong_one_is_told_what_to_mend(wrong: type[Aggregator], says: str, mend: str) -> None:
    with pytest.raises(ConformanceError, match=rf"^{wrong.__name__}: .*{says}.*; .*{mend}"):
        check_aggregator(wrong)


def test_options_that_do_not_fit_are_said() -> None:
    with pytest.raises(ConformanceError, match=r"its options .* do not fit"):
        check_aggregator(Good, {"momentum": 0.5})


class Slow(Good):
    def step(self, state, models, uavs, round_):  # type: ignore[no-untyped-def]
        time.sleep(0.004)
        return super().step(state, models, uavs, round_)


def test_a_slow_one_is_told_how_slow() -> None:
    with pytest.raises(
        ConformanceError, match=r"^Slow: a round of 25 models takes \d+ ms; make it quicker, or pass a larger `slow_ms`"
    ):
        check_aggregator(Slow, slow_ms=3.0)
