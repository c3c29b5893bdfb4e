"""A good plug-in of each kind, and ways to make a wrong one of it."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Step
from meanflock.agent.controllers.filtered import Filter
from meanflock.channel.base import Channel
from meanflock.federation.codings.base import Coding, Models
from meanflock.federation.rules.base import Aggregator, State, Uploads
from meanflock.testing import (
    check_aggregator,
    check_channel,
    check_coding,
    check_controller,
    check_filter,
    check_vehicle,
)
from meanflock.worldsim.vehicles.base import Hidden, Vehicle


class GoodController(Controller):
    """A controller with memory, diagnostics, a model and two broadcasts."""

    name = "good"
    parameters = 3
    period_ticks = 15
    diagnostics = ("heard",)

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        return {"model": np.zeros((len(uavs), 3)), "heard": np.zeros(len(uavs)), "uav": uavs.astype(np.int32)}

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        heard = memory["heard"].copy()
        for frames in received:
            np.add.at(heard, frames.links[:, 1], frames.payload[frames.links[:, 0], 0])
        after = memory | {"heard": heard, "model": memory["model"] + 0.1}
        broadcasts = [Broadcast(own)]
        even = np.flatnonzero(memory["uav"] % 2 == 0)
        if len(even):
            broadcasts.append(Broadcast(own[even, :1].astype(np.int16), even))
        return Step(after, -0.01 * own[:, :2] + 1e-6 * heard[:, None], heard[:, None], broadcasts)

    def get(self, memory: Memory) -> np.ndarray:
        return memory["model"]

    def set(self, memory: Memory, rows: np.ndarray, models: np.ndarray) -> Memory:
        model = memory["model"].copy()
        model[rows] = models
        return memory | {"model": model}


class GoodFilter(Filter):
    """Pulls away from the mean of all others."""

    name = "good"
    columns = ("apart",)

    def admit(self, own: Any, others: Any, uavs: Any, wanted: Any) -> tuple[Any, Any]:
        away = own[:, :2] - others[:, :, :2].mean(axis=1)
        return wanted + 0.1 * away, np.hypot(away[:, :1], away[:, 1:])


class GoodAggregator(Aggregator):
    name = "good"

    def init(self, parameters: int) -> State:
        return {"last": np.zeros(parameters)}

    def step(self, state: State, uploads: Uploads) -> tuple[State, np.ndarray]:
        model = 0.5 * state["last"] + 0.5 * uploads.models.mean(axis=0)
        return {"last": model}, model


class GoodChannel(Channel):
    """Loses a message in five and takes up to four slots."""

    name = "good"

    def transmit(self, distance_m: Any, bits: int, rng: np.random.Generator) -> tuple[Any, Any]:
        return rng.integers(1, 5, len(distance_m)), rng.random(len(distance_m)) < 0.8


class GoodCoding(Coding):
    """Numbers of four bits: multiples of an eighth of their piece's largest one, from −8 to 7."""

    name = "good"
    bits = 4

    def encode(self, models: Models) -> tuple[Any, Any]:
        scales = models.scales(models.largest / 7.0)
        return (np.rint(models.numbers / models.spread(scales)) + 8.0).astype(np.uint8), scales

    def decode(self, numbers: Any, scales: Any) -> Any:
        return (numbers - 8.0) * scales


class GoodVehicle(Vehicle):
    name = "good"

    def init(self, uavs: int) -> Hidden:
        return {"thrust": np.zeros((uavs, 2))}

    def step(self, states: Any, hidden: Hidden, acceleration: Any, noise: Any) -> tuple[Any, Hidden]:
        thrust = 0.5 * hidden["thrust"] + 0.5 * acceleration
        dt = self.scenario.dt
        velocity = states[:, 2:] + dt * thrust + 0.01 * noise
        return np.concatenate([states[:, :2] + dt * velocity, velocity], axis=-1), {"thrust": thrust}

    def power(self, states: Any, hidden: Hidden, acceleration: Any) -> Any:
        return 1.0 + hidden["thrust"][:, 0] ** 2


class Kind(NamedTuple):
    """A suite, a class that it accepts, the method that a flight calls most, and the array in the method's answer."""

    check: Callable[..., None]
    good: type
    method: str
    position: int
    remedy: str  # part of the text where randomness is wrong
    pace: str


KINDS = {
    "controller": Kind(check_controller, GoodController, "step", 0, "mf.seeds", "a tick of 6 UAVs"),
    "filter": Kind(check_filter, GoodFilter, "admit", 0, "mf.seeds", "a tick of 6 UAVs"),
    "aggregator": Kind(check_aggregator, GoodAggregator, "step", 1, "global generators", "a round of 25 models"),
    "channel": Kind(check_channel, GoodChannel, "transmit", 0, "the generator you are given", "over 600 links"),
    "coding": Kind(check_coding, GoodCoding, "encode", 1, "mf.seeds", "a round of 25 models"),
    "vehicle": Kind(check_vehicle, GoodVehicle, "step", 0, "the argument `noise`", "a tick of 5 UAVs"),
}


def changed(good: type, method: str, change: Callable[..., Any]) -> Any:
    """A class whose `method` returns `change(self, answer, *arguments)`, `answer` being that of the good class."""

    def wrong(self: Any, *arguments: Any) -> Any:
        return change(self, getattr(good, method)(self, *arguments), *arguments)

    wrong.__name__ = method
    return type("Wrong", (good,), {method: wrong})


def having(good: type, **members: Any) -> Any:
    return type("Wrong", (good,), members)


def failing(good: type, method: str, error: BaseException) -> Any:
    def fail(*_: Any) -> Any:
        raise error

    return changed(good, method, fail)


def writing(good: type, method: str, place: int, name: str = "") -> Any:
    """A class whose `method` changes an argument in place, or the array of that name in it."""

    def write(_self: Any, answer: Any, *given: Any) -> Any:
        array = given[place][name] if name else given[place]
        array += 1
        return answer

    return changed(good, method, write)


def calls(plugin: Any) -> int:
    """The number of calls of this function with an instance, which the instance remembers."""
    plugin.calls = getattr(plugin, "calls", 0) + 1
    return int(plugin.calls)
