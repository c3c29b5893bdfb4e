"""A filter before any controller: everything of the controller passes through unchanged."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from meanflock.agent.controllers.barriers import Ecbf
from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Step
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import declared, plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Filter, Scenario, Sharing, load
from meanflock.testing import check_controller

SMALL = Scenario(uavs=6, filter=Filter(kind="ecbf"), sharing=Sharing(policy="event", delta_m=0.05, repeats=2))


@pytest.mark.parametrize("policy", ["event-4", "tick"])
@pytest.mark.parametrize("name", plugins.names("controller"))
def test_every_built_in_controller_conforms_behind_the_filter(name: str, policy: Any) -> None:
    sharing = Sharing(policy=policy, delta_m=0.05)
    scenario = Scenario(uavs=6, filter=Filter(kind="ecbf"), sharing=sharing)
    check_controller(plugins.load("controller", name), scenario=scenario)


class Talker(Controller):
    """Two broadcasts, the first in even ticks only; remembers the last numbers it heard of either."""

    name = "talker"
    parameters = 2
    weights = 1
    period_ticks = 7
    broadcast_numbers = 5
    diagnostics = ("infeasible",)

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        return {"heard": np.full((len(uavs), 2), -1.0), "model": np.zeros((len(uavs), 2))}

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        heard = memory["heard"].copy()
        for frames in received:
            heard[frames.links[:, 1], frames.number] = frames.payload[frames.links[:, 0], 0]
        even = np.arange(len(own)) if tick % 2 == 0 else np.zeros(0, dtype=np.intp)
        said = (Broadcast(np.full((len(even), 1), 100.0 + tick), even), Broadcast(np.full((len(own), 4), 200.0 + tick)))
        return Step(memory | {"heard": heard}, -0.1 * own[:, 2:], heard[:, :1], said)

    def get(self, memory: Memory) -> np.ndarray:
        return memory["model"]

    def set(self, memory: Memory, rows: np.ndarray, models: np.ndarray) -> Memory:
        model = memory["model"].copy()
        model[rows] = models
        return memory | {"model": model}

    def report(self, memory: Memory) -> np.ndarray:
        return memory["heard"][:, 1:]


def behind(inner: Controller, scenario: Scenario = SMALL, **options: Any) -> Ecbf:
    return Ecbf(Ecbf.Options(**options), scenario, inner)


def exchanged(step: Step, uavs: int) -> list[Received]:
    """All of a step's broadcasts, as all others receive them."""
    everyone = np.arange(uavs)
    found = []
    for number, one in enumerate(step.broadcasts):
        source = everyone if one.rows is None else one.rows
        links = np.stack(np.nonzero(source[:, None] != everyone), axis=-1)
        found.append(Received(number, source, one.payload, links))
    return [frames for frames in found if len(frames.source)]


def test_the_controller_keeps_its_declarations_numbers_and_models() -> None:
    made = behind(Talker(Talker.Options(), SMALL))
    said = declared.declarations_of(made, "talker")
    assert (said.parameters, said.weights, said.period_ticks, said.broadcast_numbers) == (2, 1, 7, 5 + 4)
    assert said.diagnostics == ("infeasible", "filter_infeasible", "unsent")
    uavs = np.arange(6)
    plan = np.zeros((6, 4))
    plan[:, 0], plan[:, 2] = 10.0 * uavs, 1.0
    memory, received = made.init(uavs, plan), list[Received]()
    for tick in range(4):
        step = made.step(memory, tick, plan, received)
        assert len(step.broadcasts) == 3
        memory, received = step.memory, exchanged(step, 6)
    assert memory["heard"].tolist() == [[102.0, 202.0]] * 6  # of tick 2, heard in tick 3
    assert step.broadcasts[0].payload.dtype == np.int16  # an event of the filter
    assert made.report(memory).tolist() == [[202.0]] * 6
    taught = made.set(memory, np.array([1]), np.array([[5.0, 6.0]]))
    assert made.get(taught).tolist() == [[0, 0], [5, 6], [0, 0], [0, 0], [0, 0], [0, 0]]
    assert set(taught) == set(memory)


def test_names_of_the_filter_are_refused_in_the_memory_of_the_controller_and_in_columns() -> None:
    class Clash(Talker):
        def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
            return {"filter_mine": np.zeros(len(uavs))}

    with pytest.raises(ValueError, match=r"'filter_mine'.*those of the filter"):
        behind(Clash(Talker.Options(), SMALL)).init(np.arange(6), np.zeros((6, 4)))
    for columns, expected in (("near", "write"), (("near", "near"), "different"), (("unsent",), "unsent")):
        with pytest.raises((TypeError, ValueError), match=expected):
            type("Wrong", (Open,), {"columns": columns})(Ecbf.Options(), SMALL, Talker(Talker.Options(), SMALL))


@pytest.mark.parametrize("shape", [(2,), (6, 3)])
def test_an_acceleration_of_another_shape_is_not_spread_over_the_rows(shape: tuple[int, ...]) -> None:
    odd: Any = type("Odd", (Talker,), {"step": lambda _self, memory, *_: Step(memory, np.zeros(shape))})
    made = behind(odd(Talker.Options(), SMALL))
    with pytest.raises(ValueError, match="acceleration has shape"):
        made.step(made.init(np.arange(6), np.zeros((6, 4))), 0, np.zeros((6, 4)), ())


class Open(plugins.load("filter", "ecbf")):  # type: ignore[misc]
    """Changes nothing; the base of the wrong filters."""

    name = "open"
    columns = ("touched",)

    def admit(self, own: np.ndarray, others: np.ndarray, uavs: np.ndarray, wanted: np.ndarray) -> Any:
        return wanted, np.zeros((len(own), 1))


@pytest.mark.parametrize(
    ("admit", "text"),
    [
        (lambda *_: 1 / 0, r"filter 'open': ZeroDivisionError: division by zero \(test_filtered.py, line \d+\)"),
        (lambda *_: exit(3), "filter 'open': SystemExit: 3"),
        (lambda *_: None, "filter 'open': TypeError: "),
        (lambda _, own, *__: own, "filter 'open': ValueError: "),
        (lambda _, own, *__: (own, own[:, :1]), r"filter 'open': .* accelerations \(6, 4\); expected \(6, 2\)"),
        (lambda *given: (given[-1], None), r"filter 'open': `admit` returns columns \(\); expected \(6, 1\)"),
    ],
)
def test_an_error_of_a_filter_names_the_filter_and_not_the_controller(admit: Any, text: str) -> None:
    made: Any = type("Wrong", (Open,), {"admit": admit})(Ecbf.Options(), SMALL, Talker(Talker.Options(), SMALL))
    with pytest.raises((RuntimeError, ValueError), match=text):
        made.step(made.init(np.arange(6), np.zeros((6, 4))), 0, np.zeros((6, 4)), ())


def test_a_filter_is_a_plugin_of_its_scenario() -> None:
    plain, some = Scenario(), Scenario(filter=Filter(kind="ecbf"))
    assert ("filter", "ecbf") in {(kind, name) for kind, name, _ in some.plugins()}
    assert "filter" not in {kind for kind, _, _ in plain.plugins()}
    with pytest.raises(BadInput, match=r"filter 'magic' is not installed here; .*; there are braking, ecbf"):
        Engine(load(None, ["filter.kind=magic"]), "filtered")
    with pytest.raises(BadInput, match=r"filter.options.distance_m: .*> 0.*'ecbf'"):
        Engine(load(None, ["filter.kind=ecbf", "filter.options.distance_m=0"]), "filtered")
    with pytest.raises(
        BadInput, match=r"`\[sharing\]` is set, but controller 'mfgfl-hf' shares no states; .*filter.kind"
    ):
        Engine(load(None, ["sharing.policy=tick"]), "filtered")


def test_the_paper_s_learner_collides_alone_and_not_behind_the_filter() -> None:
    alone = Engine(load(None, ["uavs=16", "duration=90"], method="mfgfl-h", seed=7), "alone").complete()
    behind = load(None, ["uavs=16", "duration=90", "filter.kind=ecbf"], method="mfgfl-h", seed=7)
    summary = Engine(behind, "filtered").complete()
    assert alone["collisions"] > 0
    assert summary["collisions"] == 0
    assert summary["rounds"] == alone["rounds"] > 0
    assert summary["payload_bits"]["state"] > alone["payload_bits"]["state"]
    assert set(summary["diagnostics"]) == {*alone["diagnostics"], "infeasible", "unsent"}
