"""A good controller, and one for each way to go wrong."""

import random
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

import meanflock as mf
from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Step
from meanflock.swarm.scenario import Scenario


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


class DrawsAsItShould(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        index = tick * self.scenario.uavs + memory["uav"]
        noise = [mf.seeds.generator(self.scenario.seed, "controller", int(k)).standard_normal(2) for k in index]
        return Step(
            step.memory, step.acceleration + np.reshape(noise, (len(own), 2)), step.diagnostics, step.broadcasts
        )


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


class WritesToItsStates(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        step = super().step(memory, tick, own, received)
        own[:] = 0.0  # the same, however often
        return step


class NamedAsAColumn(Good):
    diagnostics = ("arrived",)


class Slow(Good):
    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        time.sleep(0.004)
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
