"""The suite for controllers lets ours and a stranger's through, and says of every kind of wrong one what to mend."""

import random
import re
import runpy
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Step
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Obstacle, Scenario, Start
from meanflock.testing import ConformanceError, check_aggregator, check_controller

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize("name", plugins.names("controller"))
def test_every_controller_of_ours_conforms(name: str) -> None:
    check_controller(plugins.load("controller", name))


DISCS = (Obstacle(centre=(140.0, 96.0), radius=4.0), Obstacle(centre=(152.0, 90.0), radius=3.0))


@pytest.mark.parametrize("name", ["vasarhelyi", "olfati-saber", "potential-field"])
@pytest.mark.parametrize("uavs", [1, 6])
@pytest.mark.parametrize("options", [{"broadcast": "tick", "forget_s": 0.2}, {"repeats": 3, "delta_m": 0.02}])
def test_a_flock_conforms_alone_and_among_obstacles(name: str, uavs: int, options: dict[str, Any]) -> None:
    scenario = Scenario(uavs=uavs, obstacles=DISCS, start=Start(spacing=0.5))
    check_controller(plugins.load("controller", name), options, scenario)


@pytest.mark.parametrize(("file", "name"), [("spring.py", "Spring"), ("trim.py", "Trim")])
def test_the_examples_conform(file: str, name: str) -> None:
    check_controller(runpy.run_path(str(EXAMPLES / file))[name], {"stiffness": 0.05})


def test_the_example_of_a_rule_conforms() -> None:
    check_aggregator(runpy.run_path(str(EXAMPLES / "momentum.py"))["Momentum"], {"beta": 0.9})


def test_the_first_example_is_short_and_imports_the_python_door_alone() -> None:
    text = (EXAMPLES / "spring.py").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 25
    assert re.findall(r"^(?:import|from) (\w+)", text, flags=re.M) == ["typing", "numpy", "msgspec", "meanflock"]


class Good(Controller):
    """A controller with memory, diagnostics, a model and two broadcasts, from which the wrong ones are made."""

    name = "good"
    parameters = 3
    diagnostics = ("heard",)

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        return {"model": np.zeros((len(uavs), 3)), "heard": np.zeros(len(uavs)), "uav": uavs.astype(np.int32)}

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        heard = memory["heard"].copy()
        for frames in received:
            np.add.at(heard, frames.links[:, 1], frames.payload[frames.links[:, 0], 0])
        after = memory | {"heard": heard, "model": memory["model"] + 0.1}
        even = np.flatnonzero(memory["uav"] % 2 == 0)
        said = [Broadcast(own), *([Broadcast(own[even, :1].astype(np.int16), even)] if len(even) else [])]
        return Step(after, -0.01 * own[:, :2] + 1e-6 * heard[:, None], heard[:, None], said)

    def get(self, memory: Memory) -> np.ndarray:
        return memory["model"]

    def set(self, memory: Memory, rows: np.ndarray, models: np.ndarray) -> Memory:
        model = memory["model"].copy()
        model[rows] = models
        return memory | {"model": model}


def test_a_good_one_conforms() -> None:
    check_controller(Good)


class DrawsAsItShould(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        index = tick * self.scenario.uavs + memory["uav"]
        noise = [mf.seeds.generator(self.scenario.seed, "controller", int(k)).standard_normal(2) for k in index]
        return Step(
            step.memory, step.acceleration + np.reshape(noise, (len(own), 2)), step.diagnostics, step.broadcasts
        )


def test_one_that_draws_by_tick_and_uav_conforms() -> None:
    check_controller(DrawsAsItShould)


class SeesAnotherRow(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        return Step(step.memory, step.acceleration + own[:, :2].mean(axis=0), step.diagnostics, step.broadcasts)


class DrawsItsOwn(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        return Step(step.memory, step.acceleration + random.random(), step.diagnostics, step.broadcasts)


class DrawsFromNumPy(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        noise = np.random.standard_normal(own[:, :2].shape)  # noqa: NPY002  # what must be caught
        return Step(step.memory, step.acceleration + noise, step.diagnostics, step.broadcasts)


class RemembersElsewhere(Good):
    ticks = 0

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        self.ticks += 1
        step = super().step(memory, tick, own, received)
        return Step(step.memory, step.acceleration * self.ticks, step.diagnostics, step.broadcasts)


class WrongAcceleration(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        return Step(step.memory, np.zeros((len(own), 3)), step.diagnostics, step.broadcasts)


class NoDiagnostics(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        return Step(step.memory, step.acceleration, None, step.broadcasts)


class WrongModel(Good):
    parameters = 4


class NotANumber(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        with np.errstate(all="ignore"):
            return Step(step.memory, step.acceleration / 0.0, step.diagnostics, step.broadcasts)


class WritesToItsArguments(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        memory["heard"] += 1.0
        return super().step(memory, tick, own, received)


class Slow(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        end = time.perf_counter() + 0.004
        while time.perf_counter() < end:
            pass
        return super().step(memory, tick, own, received)


class SetsEverybody(Good):
    def set(self, memory: Memory, rows: np.ndarray, models: np.ndarray) -> Memory:
        return memory | {"model": np.repeat(models[:1], len(memory["model"]), axis=0)}


class Raises(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        return super().step(memory, tick, own, [received[0]])


class Nameless(Good):
    name = ""


class WrongMemory(Good):
    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Any:
        return {"model": np.zeros(3)}


class NotANumberBroadcast(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        return Step(step.memory, step.acceleration, step.diagnostics, [Broadcast(own * np.inf)])


class NotANumberMemory(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        after = step.memory | {"heard": np.full(len(own), np.nan)}
        return Step(after, step.acceleration, step.diagnostics, step.broadcasts)


class NotANumberModel(Good):
    def get(self, memory: Memory) -> np.ndarray:
        return np.full((len(memory["model"]), 3), np.nan)


class OtherWidths(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        many = 1 + int(memory["uav"].sum() > 3)
        return Step(step.memory, step.acceleration, step.diagnostics, [Broadcast(np.zeros((len(own), many)))])


class RefusesNobody(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        return Step(step.memory, step.acceleration, step.diagnostics, step.broadcasts, np.array([-1]))


class Leaves(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        raise SystemExit(3)


class CannotBeMade(Good):
    def __init__(self, options: Any, scenario: Scenario) -> None:
        raise OSError("no such device")


class GetRaises(Good):
    def get(self, memory: Memory) -> np.ndarray:
        raise KeyError("weights")


class SetRaises(Good):
    def set(self, memory: Memory, rows: np.ndarray, models: np.ndarray) -> Memory:
        raise KeyError("weights")


class SetReturnsTheRows(Good):
    def set(self, memory: Memory, rows: np.ndarray, models: np.ndarray) -> Memory:
        return memory | {"model": models}


class SetReturnsNothing(Good):
    def set(self, memory: Memory, rows: np.ndarray, models: np.ndarray) -> Any:
        return None


class ReportRaises(Good):
    weights = 2

    def report(self, memory: Memory) -> np.ndarray:
        raise KeyError("weights")


class WritesToTheNumbers(Good):
    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        memory = super().init(uavs, plan)
        uavs += 1
        return memory


class WritesToThePlan(Good):
    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        plan *= 2.0
        return super().init(uavs, plan)


class Elsewhere(Good):
    name = "../elsewhere"


class Silent(Controller):
    name = "silent"


class TakesNoModel(Good):
    set = Controller.set


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (NotANumberBroadcast, "broadcast 0 has a number that is not finite; such a frame is not sent"),
        (NotANumberMemory, r"memory\['heard'\] is not finite; guard"),
        (NotANumberModel, "`get` returns a number that is not finite; guard"),
        (OtherWidths, "broadcast 0 is 1 × float64 and 2 × float64, as the UAV is; say as many"),
        (RefusesNobody, "`refused` names UAVs from -1"),
        (Leaves, r"failed in tick 0: SystemExit: 3 \(test_controllers.py, line \d+\)"),
        (CannotBeMade, r"cannot be made: OSError: no such device \(test_controllers.py, line \d+\)"),
        (GetRaises, "`get` failed: KeyError: 'weights'.*; return one row a UAV, `parameters` wide"),
        (SetRaises, "`set` failed: KeyError: 'weights'.*; return the memory with `models`"),
        (SetReturnsTheRows, r"`set` returns what a flight cannot use: memory\['model'\] is \(2, 3\)"),
        (SetReturnsNothing, "`set` returns what a flight cannot use: the memory is a NoneType"),
        (ReportRaises, "`report` failed: KeyError: 'weights'"),
        (WritesToTheNumbers, "`init` writes to an array it was given; return new arrays"),
        (WritesToThePlan, "`init` writes to an array it was given; return new arrays"),
        (Elsewhere, "a name is up to 64 of"),
        (Silent, "lacks `step`"),
        (TakesNoModel, "declares `parameters` must override `set`"),
        (SeesAnotherRow, "beside others in one process than alone.*every row"),
        (DrawsItsOwn, "a second time.*mf.seeds"),
        (DrawsFromNumPy, "a second time.*mf.seeds"),
        (RemembersElsewhere, "checkpoint differs.*memory you return"),
        (WrongAcceleration, r"acceleration has shape \(\d, 3\); expected \(\d, 2\)"),
        (NoDiagnostics, "no diagnostics"),
        (WrongModel, r"`get` returns shape \(6, 3\), expected \(6, 4\)"),
        (NotANumber, "not finite.*guard"),
        (WritesToItsArguments, "writes to an array.*copy"),
        (SetsEverybody, "rows it was not told to"),
        (Raises, "failed in tick 0: IndexError"),
        (Nameless, "no `name`"),
        (WrongMemory, "leading axis"),
    ],
)
def test_a_wrong_one_is_told_what_to_mend(wrong: type[Controller], says: str) -> None:
    with pytest.raises(ConformanceError, match=says):
        check_controller(wrong)


def test_a_slow_one_is_told_how_slow() -> None:
    with pytest.raises(ConformanceError, match=r"takes \d+ ms"):
        check_controller(Slow, slow_ms=3.0)


@pytest.mark.parametrize("given", ["good", Good(Good.Options(), Scenario())])
def test_what_is_no_class_is_told_so(given: Any) -> None:
    with pytest.raises(ConformanceError, match="it is no class; pass the class itself"):
        check_controller(given)
