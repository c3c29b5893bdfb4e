"""A filter before any controller: everything of the controller passes through unchanged."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from meanflock.agent.controllers.barriers import Ecbf
from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.swarm import declared, plugins
from meanflock.swarm.scenario import Filter, Scenario, Sharing
from meanflock.testing.trial import PointSwarm
from tests.testing.good import GoodController

SMALL = Scenario(uavs=6, filter=Filter(kind="ecbf"), sharing=Sharing(policy="event", delta_m=0.05, repeats=2))


class Open(plugins.load("filter", "ecbf")):  # type: ignore[misc]
    """Changes nothing; the base of the wrong filters."""

    name = "open"
    columns = ("touched",)

    def admit(self, own: np.ndarray, others: np.ndarray, uavs: np.ndarray, wanted: np.ndarray) -> Any:
        return wanted, np.zeros((len(own), 1))


class Talker(GoodController):
    """Hears each broadcast by its number, and reports what it heard."""

    weights = 1
    period_ticks = 7
    broadcast_numbers = 5

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        told = [replace(frames, payload=(1.0 + frames.number) * frames.payload) for frames in received]
        return super().step(memory, tick, own, told)

    def report(self, memory: Memory) -> np.ndarray:
        return memory["heard"][:, None]


def talker() -> Controller:
    return Talker(Talker.Options(), SMALL)


def behind(filter_: Any, **options: Any) -> Any:
    return filter_(Ecbf.Options(**options), SMALL, talker())


def test_behind_a_filter_that_changes_nothing_a_controller_declares_flies_and_learns_as_alone() -> None:
    said = declared.declarations_of(behind(Ecbf), "good")
    assert (said.parameters, said.weights, said.period_ticks, said.broadcast_numbers) == (3, 1, 7, 5 + 4)
    assert said.diagnostics == ("heard", "infeasible", "unsent")
    bare, filtered = (PointSwarm(Talker, SMALL, make) for make in (talker, lambda: behind(Open)))
    alone, other = bare.trial(), filtered.trial()
    for mine, theirs in zip(alone.commands, other.commands, strict=True):
        np.testing.assert_array_equal(mine, theirs[:, :3])
    for sent, also in zip(alone.broadcasts, other.broadcasts, strict=True):
        assert also[0][1].dtype == np.int16  # an event of the filter
        for one, its in zip(sent, also[1:], strict=True):
            assert [part.tobytes() for part in one] == [part.tobytes() for part in its]
    assert alone.models.tobytes() == other.models.tobytes()
    made, rows, models = behind(Open), np.array([1]), np.array([[5.0, 6.0, 7.0]])
    taught = made.set(other.memory, rows, models)
    np.testing.assert_array_equal(made.get(taught), talker().get(talker().set(alone.memory, rows, models)))
    np.testing.assert_array_equal(made.report(taught), alone.memory["heard"][:, None])
    assert set(taught) == set(other.memory)


def test_names_of_the_filter_are_refused_in_the_memory_of_the_controller_and_in_columns() -> None:
    class Clash(GoodController):
        def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
            return {"filter_mine": np.zeros(len(uavs))}

    with pytest.raises(ValueError, match=r"'filter_mine'.*those of the filter"):
        Ecbf(Ecbf.Options(), SMALL, Clash(Clash.Options(), SMALL)).init(np.arange(6), np.zeros((6, 4)))
    for columns, expected in (("near", "write"), (("near", "near"), "different"), (("unsent",), "unsent")):
        with pytest.raises((TypeError, ValueError), match=expected):
            type("Wrong", (Open,), {"columns": columns})(Ecbf.Options(), SMALL, talker())


@pytest.mark.parametrize(
    ("admit", "text"),
    [
        (lambda *_: 1 / 0, r"filter 'open': ZeroDivisionError: division by zero \(test_filtered.py, line \d+\)"),
        (lambda _, own, *__: (own, own[:, :1]), r"filter 'open': .* accelerations \(6, 4\); expected \(6, 2\)"),
        (lambda *given: (given[-1], None), r"filter 'open': `admit` returns columns \(\); expected \(6, 1\)"),
    ],
)
def test_an_error_of_a_filter_names_the_filter_and_not_the_controller(admit: Any, text: str) -> None:
    made: Any = type("Wrong", (Open,), {"admit": admit})(Ecbf.Options(), SMALL, talker())
    with pytest.raises((RuntimeError, ValueError), match=text):
        made.step(made.init(np.arange(6), np.zeros((6, 4))), 0, np.zeros((6, 4)), ())
