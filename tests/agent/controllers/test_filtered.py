"""A filter stands before any controller: what is the controller's passes through, to the bit."""

import runpy
from collections.abc import Sequence
from pathlib import Path
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

EXAMPLES = Path(__file__).parents[3] / "examples"
SMALL = Scenario(uavs=6, filter=Filter(kind="ecbf"), sharing=Sharing(policy="event", delta_m=0.05, repeats=2))


@pytest.mark.parametrize("policy", ["event-4", "tick"])
@pytest.mark.parametrize("name", plugins.names("controller"))
def test_every_controller_of_ours_conforms_behind_it(name: str, policy: Any) -> None:
    sharing = Sharing(policy=policy, delta_m=0.05)
    scenario = Scenario(uavs=6, filter=Filter(kind="ecbf"), sharing=sharing)
    check_controller(plugins.load("controller", name), scenario=scenario)


@pytest.mark.parametrize(("file", "name"), [("spring.py", "Spring"), ("trim.py", "Trim")])
def test_so_do_those_of_strangers(file: str, name: str) -> None:
    check_controller(runpy.run_path(str(EXAMPLES / file))[name], scenario=SMALL)


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


def test_the_controller_sees_its_own_numbers_and_none_of_the_filter_s() -> None:
    made = behind(Talker(Talker.Options(), SMALL))
    uavs = np.arange(6)
    plan = np.zeros((6, 4))
    plan[:, 0], plan[:, 2] = 10.0 * uavs, 1.0
    memory, received = made.init(uavs, plan), list[Received]()
    for tick in range(4):
        step = made.step(memory, tick, plan, received)
        assert len(step.broadcasts) == 3
        memory, received = step.memory, exchanged(step, 6)
    assert memory["heard"].tolist() == [[102.0, 202.0]] * 6  # of tick 2, heard in tick 3
    assert step.broadcasts[0].payload.dtype == np.int16  # events of the filter: nobody flew as it said
    assert made.report(memory).tolist() == [[202.0]] * 6
    taught = made.set(memory, np.array([1]), np.array([[5.0, 6.0]]))
    assert made.get(taught).tolist() == [[0, 0], [5, 6], [0, 0], [0, 0], [0, 0], [0, 0]]
    assert set(taught) == set(memory)


def test_what_the_controller_declares_is_declared() -> None:
    said = declared.declarations_of(behind(Talker(Talker.Options(), SMALL)), "talker")
    assert (said.parameters, said.weights, said.period_ticks) == (2, 1, 7)
    assert said.broadcast_numbers == 5 + 4
    assert said.diagnostics == ("infeasible", "filter_infeasible", "unsent")


def test_a_name_of_the_filter_s_cannot_be_remembered_by_the_controller() -> None:
    class Clash(Talker):
        def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
            return {"filter_mine": np.zeros(len(uavs))}

    with pytest.raises(ValueError, match=r"'filter_mine'.*those of the filter"):
        behind(Clash(Talker.Options(), SMALL)).init(np.arange(6), np.zeros((6, 4)))


@pytest.mark.parametrize("shape", [(), (2,), (6,), (6, 3), (1, 2)])
def test_an_acceleration_of_another_shape_is_not_spread_over_the_rows(shape: tuple[int, ...]) -> None:
    class Odd(Talker):
        def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
            return Step(memory, np.zeros(shape))

    made = behind(Odd(Talker.Options(), SMALL))
    with pytest.raises(ValueError, match="acceleration has shape"):
        made.step(made.init(np.arange(6), np.zeros((6, 4))), 0, np.zeros((6, 4)), ())


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (["filter.kind=magic"], r"filter 'magic' is not installed here; .*; there are braking, ecbf"),
        (["filter.kind=ecbf", "filter.options.distance_m=0"], r"filter.options.distance_m: .*> 0.*'ecbf'"),
        (["filter.kind=ecbf", "filter.options.wings=2"], r"filter.options.*wings"),
        (["filter.kind=ecbf", "sharing.repeats=17"], r"sharing.repeats"),
        (["sharing.policy=tick"], r"`\[sharing\]` is set, but controller 'mfgfl-hf' shares no states; .*filter.kind"),
        (["filter.kind=ecbf", "sharing.policy=shout"], r"sharing.policy"),
        (["filter.wings=2"], r"wings"),
    ],
)
def test_what_cannot_be_filtered_is_bad_input_of_one_line(settings: list[str], text: str) -> None:
    with pytest.raises(BadInput, match=text) as caught:
        Engine(load(None, settings), "filtered")
    assert len(str(caught.value).splitlines()) == 1


class Open(plugins.load("filter", "ecbf")):  # type: ignore[misc]
    """Lets everything through, from which the wrong ones are made."""

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
        (
            lambda _, own, *__: (own, own[:, :1]),
            r"filter 'open': .* accelerations \(6, 4\); expected \(6, 2\)",
        ),
        (lambda *of: (of[-1], np.zeros((6, 2))), r"filter 'open': `admit` returns columns \(6, 2\); expected \(6, 1\)"),
        (lambda *of: (of[-1], None), r"filter 'open': `admit` returns columns \(\); expected \(6, 1\)"),
    ],
)
def test_what_is_wrong_with_a_filter_is_said_of_it_and_not_of_the_controller(admit: Any, text: str) -> None:
    made = type("Wrong", (Open,), {"admit": admit})(Ecbf.Options(), SMALL, Talker(Talker.Options(), SMALL))
    with pytest.raises((RuntimeError, ValueError), match=text):
        made.step(made.init(np.arange(6), np.zeros((6, 4))), 0, np.zeros((6, 4)), ())


def test_columns_that_are_a_text_are_refused() -> None:
    with pytest.raises(TypeError, match=r"write \('touched',\)"):
        type("Wrong", (Open,), {"columns": "touched"})(Ecbf.Options(), SMALL, Talker(Talker.Options(), SMALL))


@pytest.mark.parametrize("columns", [("near", "near"), ("unsent",)])
def test_columns_twice_are_said_of_the_filter(columns: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=r"`columns` .* must be different names, and none of them 'unsent'"):
        type("Wrong", (Open,), {"columns": columns})(Ecbf.Options(), SMALL, Talker(Talker.Options(), SMALL))


def test_a_controller_that_writes_to_its_states_does_not_deceive_the_filter() -> None:
    class Writes(Talker):
        def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
            step = super().step(memory, tick, own, received)
            own[:] = 1e6
            return step

    honest, writes = (behind(one(Talker.Options(), SMALL)) for one in (Talker, Writes))
    own = np.linspace(0.0, 3.0, 24).reshape(6, 4)
    memory = honest.init(np.arange(6), own)
    one, other = (made.step(memory, 0, own.copy(), ()) for made in (honest, writes))
    np.testing.assert_array_equal(one.acceleration, other.acceleration)
    np.testing.assert_array_equal(one.broadcasts[0].payload, other.broadcasts[0].payload)


def test_scenarios_without_a_filter_keep_their_hash_and_others_have_their_own() -> None:
    plain, some = Scenario(), Scenario(filter=Filter(kind="ecbf"))
    assert plain.sha256() == Scenario(filter=Filter()).sha256() != some.sha256()
    assert ("filter", "ecbf") in {(door, name) for door, name, _ in some.plugins()}
    assert "filter" not in {door for door, _, _ in plain.plugins()}


# -- flights ------------------------------------------------------------------------------------------------------


def test_the_paper_s_learner_collides_alone_and_not_behind_the_filter() -> None:
    alone = Engine(load(None, ["uavs=16", "duration=90"], method="mfgfl-h", seed=7), "alone").complete()
    behind = load(None, ["uavs=16", "duration=90", "filter.kind=ecbf"], method="mfgfl-h", seed=7)
    summary = Engine(behind, "filtered").complete()
    assert alone["collisions"] > 0
    assert summary["collisions"] == 0
    assert summary["rounds"] == alone["rounds"] > 0
    assert summary["payload_bits"]["state"] > alone["payload_bits"]["state"]
    assert set(summary["diagnostics"]) == {*alone["diagnostics"], "infeasible", "unsent"}
