"""Controller that measures the wind in flight, maps it, and flies the cheapest way through the map.

The wind acts on a UAV as v̇ = a − c0 (v − w(r)) + noise, so every tick is a noisy measurement of w. The UAV stores its
measurements as information at the nodes of a map (`belief.py`), and every few seconds chooses the cheapest way through
that map (`route.py`). The option `share` says what UAVs learn from each other:

- `none`: nothing.
- `weights`: the federation averages the winds at the nodes. A UAV without measurements at a node contributes its prior,
  with the same weight.
- `precision`: the federation averages winds by their precisions, with the aggregation rule `precision`.
- `measurements`: every UAV broadcasts the mean of its measurements of two seconds, and their position.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Rows, Step, believed, of_kind
from meanflock.agent.controllers.cruise import SLOWING_1_S, limited
from meanflock.agent.controllers.wind.belief import INFORMATION, WindGrid
from meanflock.agent.controllers.wind.route import Corridor, Fare, Router
from meanflock.agent.controllers.wind.straight import LIMIT_M_S2
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, States
from meanflock.swarm.wire.messages import NOBODY

MEASURED = 4  # numbers of a measurement: x, y, and the wind along x and y
BEYOND = 6.0  # standard deviations beyond which a measurement is an outlier
LOOK_M = 6.0  # distance of the target point ahead on the way


class Windmap(Controller):
    """Measures the wind, maps it, and flies by the map."""

    name = "windmap"
    diagnostics = ("wind_x_m_s", "wind_y_m_s", "mapped")

    class Options(base.Options, frozen=True):
        """The options of `windmap`."""

        share: Annotated[
            Literal["none", "weights", "precision", "measurements"], Meta(description="what the UAVs share")
        ] = "none"
        time_price_w: Annotated[float, Meta(ge=0, description="cost of a second in addition to the energy, W")] = 0.05
        spacing_m: Annotated[float, Meta(gt=0, description="spacing of the nodes of the map, m")] = 15.0
        width_m: Annotated[float, Meta(gt=0, description="half width of the map, m")] = 30.0
        rms_m_s: Annotated[
            float, Meta(gt=0, description="prior rms of the deviation from the mean wind, an axis, m/s")
        ] = 0.7
        scale_m: Annotated[float, Meta(gt=0, description="correlation length of the deviation, m")] = 30.0
        replan_s: Annotated[float, Meta(gt=0, description="time between two choices of a way, s")] = 5.0
        period_s: Annotated[float, Meta(gt=0, description="time between two rounds, if the map is federated, s")] = 20.0
        speak_s: Annotated[float, Meta(gt=0, description="time over which a broadcast measurement is averaged, s")] = (
            2.0
        )
        velocity_gain_1_s: Annotated[float, Meta(gt=0, description="k_v, 1/s")] = 1.0

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        dt, wind = scenario.dt, scenario.wind
        self._drag, self._mean = max(wind.drag, 1e-6), np.array(wind.mean)
        self._deviation = max(wind.sigma, 1e-3) / np.sqrt(dt) / self._drag  # of a tick's measurement, m/s
        self._broadcast_ticks, self._replans = (
            max(1, round(each / dt)) for each in (options.speak_s, options.replan_s)
        )
        self.period_ticks = max(1, round(options.period_s / dt))
        self.broadcast_numbers = MEASURED if options.share == "measurements" else 0
        self._numbers = {"weights": INFORMATION - 1, "precision": INFORMATION}.get(
            options.share, 0
        )  # shared numbers of a node
        self.parts = (self._grid.count,) * self._numbers
        self.parameters = sum(self.parts)

    @cached_property
    def _corridor(self) -> Corridor:
        return Corridor(self.scenario)

    @cached_property
    def _grid(self) -> WindGrid:
        options, way = self.options, self._corridor
        margin = options.spacing_m
        origin = way.goal - margin * way.back
        return WindGrid(
            origin,
            way.back,
            way.length_m + 2 * margin,
            options.width_m,
            options.spacing_m,
            options.rms_m_s,
            options.scale_m,
        )

    @cached_property
    def _router(self) -> Router:
        way, options = self._corridor, self.options
        return Router(Fare(self.scenario, options.time_price_w), way.back, way.length_m, options.width_m, self._mean)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        rows = len(uavs)
        nodes = self._grid.count
        stations = self._router.stations
        memory: Memory = {
            "uav": uavs.astype(np.int32),
            "state": plan[uavs],
            "commanded": np.zeros((rows, state.axes(plan))),
            "tick": np.full(rows, -2, dtype=np.int32),  # of these two
            "information": np.zeros(
                (rows, nodes, INFORMATION)
            ),  # own measurements, or those since the last global model
            "map": np.zeros((rows, nodes, INFORMATION - 1)),
            "ways": np.zeros((rows, stations)),
            "speeds": np.ones((rows, stations)),
        }
        if self._numbers:
            memory["shared"] = np.zeros((rows, nodes, self._numbers))  # the global model
        if self.options.share == "measurements":
            memory["unsent"] = np.zeros(
                (rows, MEASURED + 1)
            )  # sums of the next broadcast, and the number of measurements
        return memory

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        uavs = memory["uav"]
        refused = NOBODY
        memory, wind, valid = self._measure(memory, tick, own)
        broadcasts: tuple[Broadcast, ...] = ()
        if self.options.share == "measurements":
            memory, refused = self._receive(memory, received)
            memory, broadcasts = self._broadcast(memory, tick, wind, valid)
        goals, since = self._corridor.goals[uavs], tick - self._corridor.launches[uavs]
        due = (since >= 0) & (since % self._replans == 0)
        if due.any():
            memory = self._look(memory, np.flatnonzero(due), goals, own)
        felt = self._grid.at(memory["map"], state.position(own)) + self._mean
        off = state.position(own) - goals
        place, speed = self._router.ahead(memory["ways"], memory["speeds"], off, LOOK_M)
        towards = place - off
        pace = np.minimum(speed, SLOWING_1_S * state.norm(off)) / np.maximum(state.norm(towards), 1e-9)
        wanted = self.options.velocity_gain_1_s * (towards * pace[:, None] - state.velocity(own))
        acceleration = limited(wanted, LIMIT_M_S2) + self._drag * (state.velocity(own) - felt)
        known = self._information(memory)[..., -1]
        mapped = (known / (known + self.options.rms_m_s**-2)).mean(axis=1)
        after = memory | {
            "state": own,
            "commanded": acceleration,
            "tick": np.full(len(own), tick, dtype=np.int32),
        }
        reported = np.concatenate([felt, mapped[:, None]], axis=1)
        return Step(after, acceleration, reported, broadcasts, refused)

    def get(self, memory: Memory) -> Floats:
        if not self.parameters:
            return super().get(memory)
        averaged = self.options.share == "weights"
        model = self._believed(memory) if averaged else _joined(memory["shared"], memory["information"])
        return model.transpose(0, 2, 1).reshape(len(model), -1)

    def set(self, memory: Memory, rows: Rows, models: Floats) -> Memory:
        shared, information = memory["shared"].copy(), memory["information"].copy()
        shared[rows] = models.reshape(len(models), -1, self._grid.count).transpose(0, 2, 1)
        information[rows] = 0.0  # the uploaded information is in the global model
        return memory | {"shared": shared, "information": information}

    def _measure(self, memory: Memory, tick: int, own: States) -> tuple[Memory, Floats, NDArray[np.bool_]]:
        """Returns the memory with the last tick's measurement, the deviation from the mean wind (M, 2), and a mask of
        valid measurements (M,).
        """
        before = memory["state"]
        fresh = (memory["tick"] == tick - 1) & (tick > self._corridor.launches[memory["uav"]])
        change = (state.velocity(own) - state.velocity(before)) / self.scenario.dt - memory["commanded"]
        wind = state.velocity(before) + change / self._drag - self._mean
        valid = fresh & (np.abs(wind) < self._most(1)).all(axis=1)
        rows = np.flatnonzero(valid)
        if not len(rows):
            return memory, wind, valid
        each = np.full(len(rows), self._deviation**-2)
        new = self._grid.informed(rows, state.position(before[rows]), wind[rows], each, len(own))
        return memory | {"information": memory["information"] + new}, wind, valid

    def _most(self, ticks: int) -> float:
        """Bound of a measured deviation, averaged over so many ticks, m/s."""
        return float(BEYOND * np.sqrt(self._deviation**2 / ticks + self.options.rms_m_s**2))

    def _broadcast(
        self, memory: Memory, tick: int, wind: Floats, valid: NDArray[np.bool_]
    ) -> tuple[Memory, tuple[Broadcast, ...]]:
        """Returns the memory, and the means of the measurements since the last broadcast, of rows with at least half of
        them."""
        now = np.concatenate([state.position(memory["state"]), wind, np.ones((len(wind), 1))], axis=1)
        sums = memory["unsent"] + np.where(valid[:, None], now, 0.0)
        if tick % self._broadcast_ticks:
            return memory | {"unsent": sums}, ()
        rows = np.flatnonzero(2.0 * sums[:, MEASURED] >= self._broadcast_ticks)
        payload = sums[rows, :MEASURED] / sums[rows, MEASURED:]
        return memory | {"unsent": np.zeros_like(sums)}, (Broadcast(payload, rows),)

    def _receive(self, memory: Memory, received: Sequence[Received]) -> tuple[Memory, NDArray[np.int32]]:
        """Returns the memory with the measurements of others, and the senders of implausible ones."""
        most, information = self._most(self._broadcast_ticks), memory["information"]
        frames, refused = believed(
            of_kind(received, MEASURED), lambda sums: np.abs(state.velocity(sums)).max(axis=1) < most
        )
        for sums in frames:
            links = sums.links[np.lexsort((sums.source[sums.links[:, 0]], sums.links[:, 1]))]  # by row, then by UAV
            measured = sums.payload[links[:, 0]]
            each = np.full(len(links), self._broadcast_ticks * self._deviation**-2)
            new = self._grid.informed(
                links[:, 1], state.position(measured), state.velocity(measured), each, len(information)
            )
            information = information + new
        return memory | {"information": information}, refused

    def _look(self, memory: Memory, rows: Rows, goals: Floats, own: States) -> Memory:
        """The memory after some rows updated their maps and chose their ways."""
        maps = memory["map"].copy()
        ways = memory["ways"].copy()
        speeds = memory["speeds"].copy()
        maps[rows] = self._believed({name: array[rows] for name, array in memory.items()})
        ways[rows], speeds[rows] = self._router.ways(self._grid, maps[rows], goals[rows], state.position(own[rows]))
        return memory | {"map": maps, "ways": ways, "speeds": speeds}

    def _believed(self, memory: Memory) -> Floats:
        """Posterior deviation from the mean wind at the nodes, (M, F, 2)."""
        base = memory["shared"] if self.options.share == "weights" else None
        return self._grid.mean(self._information(memory), base)

    def _information(self, memory: Memory) -> Floats:
        """All information of rows, (M, F, 3). A global model has the mean information of a UAV; that of all is N times
        as much.
        """
        if self.options.share != "precision":
            return memory["information"]
        shared = memory["shared"]
        precision = self.scenario.uavs * np.maximum(shared[..., -1:], 0.0)
        return memory["information"] + np.concatenate([shared[..., :-1] * precision, precision], axis=-1)


def _joined(shared: Floats, information: Floats) -> Floats:
    """Winds and precisions (M, F, 3) after more information (M, F, 3); unchanged at nodes without information."""
    precision = np.maximum(shared[..., -1:], 0.0)
    total = precision + information[..., -1:]
    wind = (shared[..., :-1] * precision + information[..., :-1]) / np.where(total > 0.0, total, 1.0)
    return np.where(information[..., -1:] > 0.0, np.concatenate([wind, total], axis=-1), shared)
