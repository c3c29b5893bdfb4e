"""The suites accept the built-in plug-ins, and reject what is wrong with a plug-in of any kind."""

import random
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest

from meanflock.agent.controllers.base import Step
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Filter, Scenario, Sharing
from meanflock.testing import (
    ConformanceError,
    check_aggregator,
    check_channel,
    check_controller,
    check_filter,
    check_vehicle,
)
from tests.testing.good import (
    GoodAggregator,
    GoodChannel,
    GoodController,
    GoodFilter,
    GoodVehicle,
    calls,
    changed,
    failing,
)


class Kind(NamedTuple):
    """A suite, a class that it accepts, the method that a flight calls most, and the array in the method's answer."""

    check: Callable[..., None]
    good: type
    method: str
    position: int
    mend: str  # part of the text where randomness is wrong
    pace: str


KINDS = {
    "controller": Kind(check_controller, GoodController, "step", 0, "mf.seeds", "a tick of 6 UAVs"),
    "filter": Kind(check_filter, GoodFilter, "admit", 0, "mf.seeds", "a tick of 6 UAVs"),
    "aggregator": Kind(check_aggregator, GoodAggregator, "step", 1, "global generators", "a round of 25 models"),
    "channel": Kind(check_channel, GoodChannel, "transmit", 0, "the generator you are given", "over 600 links"),
    "vehicle": Kind(check_vehicle, GoodVehicle, "step", 0, "the argument `noise`", "a tick of 5 UAVs"),
}
every = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


def shifted(kind: Kind, shift: Callable[[Any], Any]) -> type:
    """A class that adds a number to what a good one returns; `shift` makes it of the instance."""

    def change(self: Any, answer: Any, *_: Any) -> Any:
        number = shift(self)
        if isinstance(answer, Step):
            return msgspec.structs.replace(answer, acceleration=answer.acceleration + number)
        parts = list(answer)
        parts[kind.position] = parts[kind.position] + number
        return tuple(parts)

    return changed(kind.good, kind.method, change)  # type: ignore[no-any-return]


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind in KINDS for name in plugins.names(kind)]  # type: ignore[arg-type]
)  # fmt: skip
def test_every_built_in_plugin_conforms(kind: str, name: str) -> None:
    KINDS[kind].check(plugins.load(kind, name))  # type: ignore[arg-type]


@every
def test_a_good_plugin_conforms(kind: Kind) -> None:
    kind.check(kind.good)


@pytest.mark.parametrize("name", plugins.names("filter"))
def test_every_built_in_filter_conforms_when_states_are_sent_in_every_tick(name: str) -> None:
    check_filter(
        plugins.load("filter", name),
        scenario=Scenario(uavs=6, filter=Filter(kind=name), sharing=Sharing(policy="tick")),
    )


@every
@pytest.mark.parametrize(
    ("members", "expected"),
    [
        ({"name": ""}, "no `name`"),
        ({"name": "../elsewhere"}, "a name is up to 64 of"),
        ({"__init__": lambda *_: [].pop()}, r"cannot be made: IndexError: .* \(test_all_kinds.py, line \d+\)"),
    ],
    ids=["no name", "a path", "cannot be made"],
)
def test_a_class_that_no_flight_could_use_is_rejected(kind: Kind, members: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConformanceError, match=f"^Wrong: .*{expected}.*; .+"):
        kind.check(type("Wrong", (kind.good,), members))


@every
@pytest.mark.parametrize("given", ["good", object()])
def test_a_value_that_is_no_class_is_rejected(kind: Kind, given: Any) -> None:
    with pytest.raises(ConformanceError, match="it is no class; pass the class itself"):
        kind.check(given)


@every
def test_a_class_that_leaves_out_a_method_is_rejected(kind: Kind) -> None:
    with pytest.raises(ConformanceError, match=f"^Lacking: .* lacks .*`{kind.method}`"):
        kind.check(type("Lacking", (kind.good.__base__,), {"name": "lacking"}))  # type: ignore[arg-type]


@every
def test_options_that_do_not_fit_are_rejected(kind: Kind) -> None:
    with pytest.raises(ConformanceError, match=r"its options .*'unknown': 0.5.* do not fit"):
        kind.check(kind.good, {"unknown": 0.5})


@every
@pytest.mark.parametrize("error", [SystemExit(3), OSError("no such table")], ids=["exits", "raises"])
def test_the_suite_names_the_error_and_the_line_of_a_method_that_fails(kind: Kind, error: BaseException) -> None:
    expected = rf"`{kind.method}`.* failed.*: {type(error).__name__}: {error} \(good.py, line \d+\); .+"
    with pytest.raises(ConformanceError, match=f"^Wrong: {expected}"):
        kind.check(failing(kind.good, kind.method, error))


@every
@pytest.mark.parametrize(
    "draw",
    [lambda _: random.randrange(9), lambda _: np.random.randint(9)],  # noqa: NPY002  # what must be found
    ids=["Python", "NumPy"],
)
def test_a_plugin_that_draws_from_a_global_generator_is_rejected(kind: Kind, draw: Callable[[Any], int]) -> None:
    with pytest.raises(ConformanceError, match=f"^Wrong: .*otherwise a second time.*; .*{kind.mend}"):
        kind.check(shifted(kind, draw))


@every
def test_a_plugin_that_remembers_beside_its_arrays_is_rejected(kind: Kind) -> None:
    with pytest.raises(ConformanceError, match=r"^Wrong: .*from a checkpoint differ.*; .*keep"):
        kind.check(shifted(kind, calls))


@pytest.mark.parametrize("kind", [KINDS[name] for name in ("filter", "aggregator", "channel", "vehicle")])
def test_a_method_that_returns_one_value_instead_of_two_is_rejected(kind: Kind) -> None:
    wrong = changed(kind.good, kind.method, lambda _self, answer, *_: answer[0])
    with pytest.raises(ConformanceError, match=rf"^Wrong: .*`{kind.method}` returns a \w+[;,]"):
        kind.check(wrong)


@every
def test_a_slow_plugin_is_rejected_with_its_time(kind: Kind) -> None:
    def wait(_self: Any, answer: Any, *_: Any) -> Any:
        time.sleep(0.002)
        return answer

    expected = rf"{kind.pace} takes \d+ ms; make it quicker, or pass a larger `slow_ms`"
    with pytest.raises(ConformanceError, match=f"^Wrong: .*{expected}"):
        kind.check(changed(kind.good, kind.method, wait), slow_ms=1.0)
