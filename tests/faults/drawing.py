"""Plug-ins of all kinds that draw from a global random generator, in a flight of each."""

import random
from typing import Any

import numpy as np

from meanflock.federation.topology.leader import LeaderTopology
from tests.testing.good import GoodAggregator, GoodChannel, GoodCoding, GoodController, GoodFilter, GoodVehicle


class Controller(GoodController):
    name = "draws"

    def step(self, *given: Any) -> Any:
        random.random()
        return super().step(*given)


class Starter(GoodController):
    name = "starts"

    def init(self, *given: Any) -> Any:
        return super().init(*given) | {"drawn": np.full(len(given[0]), np.random.rand())}  # noqa: NPY002


class Filter(GoodFilter):
    name = "draws"

    def admit(self, *given: Any) -> Any:
        np.random.normal()  # noqa: NPY002
        return super().admit(*given)


class Aggregator(GoodAggregator):
    name = "draws"

    def step(self, *given: Any) -> Any:
        np.random.bytes(4)  # noqa: NPY002
        return super().step(*given)


class Channel(GoodChannel):
    name = "draws"

    def transmit(self, *given: Any) -> Any:
        random.shuffle([1, 2])
        return super().transmit(*given)


class Coding(GoodCoding):
    name = "draws"

    def encode(self, *given: Any) -> Any:
        np.random.rand()  # noqa: NPY002
        return super().encode(*given)


class Vehicle(GoodVehicle):
    name = "draws"

    def step(self, *given: Any) -> Any:
        random.random()
        return super().step(*given)


class Topology(LeaderTopology):
    name = "draws"

    def hops(self) -> Any:
        np.random.permutation(3)  # noqa: NPY002
        return super().hops()


SETTINGS = ("uavs=4", "duration=12", "stop=duration", "method=mfgfl-hf", "federation.period=20")
# Of each kind: the class, and the tick in which one process finds that it draws.
KINDS: dict[str, tuple[type, int]] = {
    "controller": (Controller, 1),
    "controller before take-off": (Starter, 1),
    "filter": (Filter, 1),
    "aggregator": (Aggregator, 101),
    "channel": (Channel, 101),
    "coding": (Coding, 1),
    "vehicle": (Vehicle, 1),
    "topology": (Topology, 0),
}
