"""The suite for controllers: it accepts what flies, and rejects each kind of mistake with its name."""

import re
import runpy
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.base import Broadcast, Controller
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Obstacle, Scenario, Sharing, Start
from meanflock.testing import ConformanceError, check_aggregator, check_controller
from tests.testing.good import GoodController, changed, failing

EXAMPLES = Path(__file__).parents[2] / "examples"
DISCS = (Obstacle(centre=(140.0, 96.0), radius=4.0), Obstacle(centre=(152.0, 90.0), radius=3.0))


@pytest.mark.parametrize("name", ["vasarhelyi", "olfati-saber", "potential-field", "bvc"])
@pytest.mark.parametrize("uavs", [1, 6])
@pytest.mark.parametrize("sharing", [Sharing(policy="tick", forget_s=0.2), Sharing(repeats=3, delta_m=0.02)])
def test_a_flock_conforms_alone_and_among_obstacles(name: str, uavs: int, sharing: Sharing) -> None:
    scenario = Scenario(uavs=uavs, obstacles=DISCS, start=Start(spacing=0.5), sharing=sharing)
    check_controller(plugins.load("controller", name), scenario=scenario)


@pytest.mark.parametrize(("file", "name"), [("spring.py", "Spring"), ("trim.py", "Trim")])
def test_the_examples_of_controllers_conform(file: str, name: str) -> None:
    check_controller(runpy.run_path(str(EXAMPLES / file))[name], {"stiffness": 0.05})


def test_the_example_of_a_rule_conforms() -> None:
    check_aggregator(runpy.run_path(str(EXAMPLES / "momentum.py"))["Momentum"], {"beta": 0.9})


def test_the_first_example_is_short_and_imports_nothing_internal() -> None:
    text = (EXAMPLES / "spring.py").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 25
    assert re.findall(r"^(?:import|from) (\w+)", text, flags=re.M) == ["typing", "numpy", "msgspec", "meanflock"]


def changed_step(**changes: Any) -> Any:
    """A controller whose step has other fields; each is a function of the good step, the memory and the states."""

    def change(_self: Any, step: Any, memory: Any, _tick: int, own: Any, _received: Any) -> Any:
        return msgspec.structs.replace(step, **{name: make(step, memory, own) for name, make in changes.items()})

    return changed(GoodController, "step", change)


def with_members(**members: Any) -> Any:
    return type("Wrong", (GoodController,), members)


def test_a_controller_that_draws_by_tick_and_uav_conforms() -> None:
    def draw(self: Any, step: Any, memory: Any, tick: int, *_: Any) -> Any:
        index = tick * self.scenario.uavs + memory["uav"]
        noise = [mf.seeds.generator(self.scenario.seed, "controller", int(k)).standard_normal(2) for k in index]
        return msgspec.structs.replace(step, acceleration=step.acceleration + np.reshape(noise, (-1, 2)))

    check_controller(changed(GoodController, "step", draw))


def test_a_controller_that_asks_when_rounds_open_conforms() -> None:
    def ask(self: Any, step: Any, _memory: Any, tick: int, *_: Any) -> Any:
        opens = tick % self.scenario.period_ticks == 0
        return msgspec.structs.replace(step, acceleration=step.acceleration + opens)

    class Asking(changed(GoodController, "step", ask)):  # type: ignore[misc]
        name = "asking"
        period_ticks = 7

    check_controller(Asking)
    check_controller(Asking, scenario=Scenario(uavs=3, federation={"period": 5}))


def writes_to_the_states(_self: Any, step: Any, _memory: Any, _tick: int, own: Any, _received: Any) -> Any:
    own[:] = 0.0
    return step


def writes_to_the_memory(_self: Any, step: Any, memory: Any, *_: Any) -> Any:
    memory["heard"] += 1.0
    return step


def writes_to_the_numbers(_self: Any, memory: Any, uavs: Any, _plan: Any) -> Any:
    uavs += 1
    return memory


def writes_to_the_plan(_self: Any, memory: Any, _uavs: Any, plan: Any) -> Any:
    plan *= 2.0
    return memory


def sets_every_row(_self: Any, _after: Any, memory: Any, _rows: Any, models: Any) -> Any:
    return memory | {"model": np.repeat(models[:1], len(memory["model"]), axis=0)}


ERROR = KeyError("weights")
WRONG: dict[str, tuple[Any, str]] = {
    "broadcasts what is not finite": (
        changed_step(broadcasts=lambda _step, _memory, own: [Broadcast(np.full_like(own, np.inf))]),
        "broadcast 0 has a number that is not finite; such a frame is not sent",
    ),
    "remembers what is not finite": (
        changed_step(memory=lambda step, _memory, own: step.memory | {"heard": np.full(len(own), np.nan)}),
        r"memory\['heard'\] is not finite; guard",
    ),
    "commands what is not finite": (
        changed_step(acceleration=lambda step, _memory, _own: step.acceleration * np.nan),
        "`step` returned a number that is not finite; guard",
    ),
    "uploads what is not finite": (
        changed(GoodController, "get", lambda _self, models, *_: models * np.nan),
        "`get` returns a number that is not finite; guard",
    ),
    "broadcasts of two widths": (
        changed_step(
            broadcasts=lambda _step, memory, own: [Broadcast(np.zeros((len(own), 1 + int(memory["uav"].sum() > 3))))]
        ),
        "broadcast 0 is 1 × float64 and 2 × float64, as the UAV is; say as many",
    ),
    "refuses a UAV that is none": (
        changed_step(refused=lambda *_: np.array([-1])),
        "`refused` names UAVs from -1",
    ),
    "sees another row": (
        changed_step(acceleration=lambda step, _memory, own: step.acceleration + own[:, :2].sum(axis=0)),
        "beside others in one process than alone.*every row",
    ),
    "accelerations of three axes": (
        changed_step(acceleration=lambda _step, _memory, own: np.zeros((len(own), 3))),
        r"acceleration has shape \(\d, 3\); expected \(\d, 2\)",
    ),
    "no diagnostics": (changed_step(diagnostics=lambda *_: None), "no diagnostics"),
    "needs a frame": (
        changed(GoodController, "step", lambda _self, step, _memory, _tick, _own, received: received[0] and step),
        "failed in tick 0: IndexError",
    ),
    "a model of another length": (with_members(parameters=4), r"`get` returns shape \(6, 3\), expected \(6, 4\)"),
    "takes no model": (with_members(set=Controller.set), "declares `parameters` must override `set`"),
    "a diagnostic named as a column": (
        with_members(diagnostics=("arrived",)),
        "the time series has columns of that name; give it another",
    ),
    "a memory without rows": (with_members(init=lambda *_: {"model": np.zeros(3)}), "leading axis"),
    "writes to its states": (changed(GoodController, "step", writes_to_the_states), "writes to an array.*copy"),
    "writes to its memory": (changed(GoodController, "step", writes_to_the_memory), "writes to an array.*copy"),
    "writes to the numbers of UAVs": (
        changed(GoodController, "init", writes_to_the_numbers),
        "`init` writes to an array it was given",
    ),
    "writes to the plan": (
        changed(GoodController, "init", writes_to_the_plan),
        "`init` writes to an array it was given",
    ),
    "fails in get": (
        failing(GoodController, "get", ERROR),
        "`get` failed: KeyError: 'weights'.*; return one row a UAV, `parameters` wide",
    ),
    "fails in set": (
        failing(GoodController, "set", ERROR),
        "`set` failed: KeyError: 'weights'.*; return the memory with `models`",
    ),
    "fails in report": (
        type("Wrong", (failing(GoodController, "report", ERROR),), {"weights": 2}),
        "`report` failed: KeyError: 'weights'",
    ),
    "set returns its rows alone": (
        with_members(set=lambda _self, memory, _rows, models: memory | {"model": models}),
        r"`set` returns what a flight cannot use: memory\['model'\] is \(2, 3\)",
    ),
    "set returns nothing": (
        with_members(set=lambda *_: None),
        "`set` returns what a flight cannot use: memory is a NoneType",
    ),
    "sets every row": (changed(GoodController, "set", sets_every_row), "rows it was not told to"),
}


@pytest.mark.parametrize(("wrong", "expected"), WRONG.values(), ids=WRONG)
def test_a_wrong_controller_is_rejected_with_its_mistake(wrong: type[Controller], expected: str) -> None:
    with pytest.raises(ConformanceError, match=f"^Wrong: .*{expected}"):
        check_controller(wrong)
