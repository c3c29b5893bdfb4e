"""The suite of learners accepts one that conforms, and says what is wrong with another."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.swarm import plugins
from meanflock.testing import ConformanceError, check_learner
from tests.agent.learning.lines import Line


def test_a_learner_conforms_and_is_not_registered_afterwards() -> None:
    check_learner(Line, {"rate": 0.02})
    assert ("learner", "line") not in {(plugin.kind, plugin.name) for plugin in plugins.installed()}


def adding(number: Callable[[Any], Any]) -> Callable[..., Any]:
    """A method `fit` that adds a number to the weights; the learner is its argument."""

    def fit(self: Any, model: Any, config: mf.Fit) -> Any:
        model["weights"] += np.float32(number(self))
        return Line.fit(self, model, config)

    return fit


def counted(holder: Any) -> int:
    holder.count = getattr(holder, "count", 0) + 1
    return holder.count


@pytest.mark.parametrize(
    ("fit", "message"),
    [
        (adding(lambda _: np.random.default_rng().normal()), "differ in a second run; draw from the global generators"),
        (adding(counted), "differ after a checkpoint; what `fit` leaves in `self` is gone"),
        (adding(lambda self: np.nan), "its trained model is not finite; it uploads no model; guard divisions"),
        (lambda *_: None, "no UAV has trained a model in a round"),
        (lambda *_: 1 / 0, "ZeroDivisionError"),
        (lambda self, model, config: mf.Trained(model, "x"), "`examples` is a str; expected a number"),
        (lambda self, model, config: mf.Trained(model, 1, {"error": []}), "'error' is a list; expected a number"),
    ],
)
def test_what_is_wrong_with_a_learner(fit: Any, message: str) -> None:
    with pytest.raises(ConformanceError, match=message):
        check_learner(type("Wrong", (Line,), {"name": "wrong", "fit": fit}))


@pytest.mark.parametrize(
    ("members", "message"),
    [
        (
            {"fit": lambda self, model: model},
            r"`fit` takes \(self, model\); write fit\(self, model, config\); no flight",
        ),
        (
            {"initial": lambda self, options, scenario: {}},
            r"`initial` takes \(self, options, scenario\); write @classmethod initial\(cls, options, scenario\); no",
        ),
        ({"metrics": "error"}, r"learner 'wrong': `metrics` is a text; write \('error',\); no flight takes it"),
        ({"metrics": ("examples",)}, "learner 'wrong': `metrics` has 'examples', a column that meanflock adds"),
        ({"keeps": "head.*"}, r"learner 'wrong': `keeps` is a text; write \('head.\*',\); no flight takes it"),
        ({"state_bytes": 2.5}, "learner 'wrong': `state_bytes` is 2.5; expected a whole number of at least 0"),
        ({"period_ticks": 0}, "learner 'wrong': `period_ticks` is 0; expected a whole number of at least 1"),
    ],
)
def test_what_is_wrong_with_the_declarations_of_a_learner(members: Any, message: str) -> None:
    with pytest.raises(ConformanceError, match=message):
        check_learner(type("Wrong", (Line,), {"name": "wrong", **members}))


def test_learners_that_share_what_changes_are_found() -> None:
    """Which of them was made last depends on checkpoints."""

    class Shared(Line):
        name = "shared"

        def __init__(self, options: Any, scenario: mf.Scenario, uav: int) -> None:
            super().__init__(options, scenario, uav)
            type(self).last = self.uav

        def fit(self, model: Any, config: mf.Fit) -> mf.Trained | None:
            model["weights"] += np.float32(self.uav == type(self).last)  # the last one made in this process
            return super().fit(model, config)

    Shared.last = -1  # type: ignore[attr-defined]
    with pytest.raises(ConformanceError, match="differ after a checkpoint"):
        check_learner(Shared)


def test_a_learner_that_draws_where_no_generator_is_seeded_is_found() -> None:
    members = {"name": "wrong", "takes_part": classmethod(lambda *_: np.random.rand() < 2)}  # noqa: NPY002
    with pytest.raises(
        ConformanceError, match=r"it draws from a global random generator.*; draw in `initial`, `fit` and"
    ):
        check_learner(type("Wrong", (Line,), members))


def test_a_controller_that_draws_late_is_found() -> None:
    from meanflock.testing import check_controller

    class Late(mf.Controller):
        name = "late"

        def step(self, memory: Any, tick: int, own: Any, received: Any) -> mf.Step:
            drawn = np.random.default_rng().normal() if tick == 150 else 0.0
            return mf.Step(memory, np.full((len(own), 2), drawn))

    with pytest.raises(ConformanceError, match="differed in a second run, in tick 150"):
        check_controller(Late)
