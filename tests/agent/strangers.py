"""An honest controller of a stranger, and functions that make wrong ones of it."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Step
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Scenario, load

BAD, WHEN = 2, 7  # the UAV whose controller goes wrong, and the tick it does in
UAVS = 5


class Honest(Controller):
    """Flies to the destination, learns two numbers, and broadcasts its state; the base of the wrong controllers."""

    name: ClassVar[str] = "stranger"
    parameters = 2
    weights = 3
    diagnostics = ("speed",)
    period_ticks = 5

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        return {"uav": uavs.astype(np.int32), "model": np.zeros((len(uavs), 2)), "ticks": np.zeros(len(uavs), np.int64)}

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        push = -0.02 * own[:, :2] - 0.3 * own[:, 2:] + 0.01 * memory["model"]
        for frames in received:
            np.add.at(push, frames.links[:, 1], 1e-6 * frames.payload[frames.links[:, 0], :2])
        after = memory | {"ticks": memory["ticks"] + 1, "model": memory["model"] + 1e-3 * own[:, :2]}
        return Step(after, push, np.abs(own[:, 2:]).sum(axis=1, keepdims=True), (Broadcast(own),))

    def get(self, memory: Memory) -> np.ndarray:
        return memory["model"]

    def set(self, memory: Memory, rows: np.ndarray, models: np.ndarray) -> Memory:
        model = memory["model"].copy()
        model[rows] = models
        return memory | {"model": model}

    def report(self, memory: Memory) -> np.ndarray:
        return np.concatenate([memory["model"], memory["ticks"][:, None]], axis=1)

    def is_time(self, memory: Memory) -> bool:
        return bool(((memory["uav"] == BAD) & (memory["ticks"] >= WHEN)).any())


def flown(made: type[Controller], *settings: str) -> Scenario:
    plugins.register(made)
    return load(None, [f"uavs={UAVS}", "duration=3", 'stop="duration"', *settings], method=made.name)


def wrong(**methods: Any) -> type[Controller]:
    return type("Wrong", (Honest,), methods)


def changed(**fields: Any) -> Any:
    """A step with other fields, of the bad UAV from some tick on."""

    def step(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        good = Honest.step(self, memory, tick, own, received)
        if not self.is_time(memory):
            return good
        parts = {name: getattr(good, name) for name in good.__struct_fields__}
        return Step(**parts | {name: make(good, memory["uav"] == BAD) for name, make in fields.items()})

    return step


def spoiled(array: np.ndarray, bad: np.ndarray, number: float) -> np.ndarray:
    array = array.copy()
    array[bad] = number
    return array


def returns(name: str, spoil: Any) -> Any:
    def method(self: Honest, memory: Memory, *more: Any) -> Any:
        good = getattr(Honest, name)(self, memory, *more)
        return spoil(good) if self.is_time(memory) else good

    return method


QUIET = ["radio.target_snr_db=60"]  # nothing is lost on the way
