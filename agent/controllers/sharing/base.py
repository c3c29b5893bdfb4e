"""Base classes of controllers whose UAVs broadcast their states, and the states of other UAVs known to each row.

A UAV broadcasts its state every tick, or at events, according to `[sharing]`. An event is an error of the state that
all others predict from its last broadcast: more than δ in position, or more than δ_v in velocity. That a group has
joined the flight since this broadcast is an event, too, because the group has not heard it. The state is sent as (x, y,
vx, vy) in 1 cm and 1 cm/s, four int16; in space six, with z and vz. The current state is sent again in the next r − 1
ticks. The origin is halfway between the UAV's own start and goal, so numbers reach 327 m; a state beyond is not sent.

A received state counts as sent in the tick before. On a slow radio it may be older. With events, a silent UAV counts as
flying as predicted, for any time. With a broadcast every tick, a silent UAV is lost or out of range, and is forgotten
(`forget_s`).
"""

import math
from abc import abstractmethod
from bisect import bisect_right
from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import (
    Broadcast,
    Controller,
    Memory,
    Options,
    Prediction,
    Received,
    Step,
    Which,
    believed,
    of_kind,
    plausible,
)
from meanflock.agent.controllers.cruise import CRUISE_M_S, SLOWING_1_S, CruiseSpeed, Slowing, Travel, against_the_air
from meanflock.agent.controllers.sharing.altitude import AltitudeLimits
from meanflock.agent.controllers.sharing.nearby import Obstacles
from meanflock.swarm import mission, plugins, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask, States, Vectors
from meanflock.swarm.wire.control import FLOAT_OF_BITS

FAR_M = 1e6  # position along x and y of a UAV whose state is unknown: far from all others
UNIT = 0.01  # of an int16, m and m/s
_MOST = float(np.iinfo(np.int16).max)


class ConstantVelocity:
    """Prediction at constant velocity: r + v·age."""

    def __init__(self, dt: float) -> None:
        self._dt = dt

    def keep(self, states: States, uavs: NDArray[np.intp], tick: int) -> Floats:
        return states

    def now(self, remembered: Floats, age: NDArray[np.int32], uavs: Which, tick: int) -> Floats:
        states, axes = np.empty(remembered.shape), remembered.shape[1] // 2  # (M, 2 axes, K)
        np.multiply(remembered[:, axes:], (age * self._dt)[:, None], out=states[:, :axes])
        states[:, :axes] += remembered[:, :axes]
        states[:, axes:] = remembered[:, axes:]
        return states


class NeighbourStates:
    """States of all UAVs known to each row, in a memory whose names begin with `neighbour_`.

    numbers: count of the numbers that a UAV broadcasts in a tick.
    """

    def __init__(self, scenario: Scenario, predict: Prediction | None = None, *, all_share: bool = False) -> None:
        """
        Args:
            predict: predicts states from the time of sending; None: at constant velocity.
            all_share: whether UAVs send their states whatever their controllers share.
        """
        self._scenario, self._all_share = scenario, all_share
        policy, self.numbers = scenario.sharing.rule, scenario.state_numbers
        self._events, self._repeats = policy.broadcast == "event", policy.repeats
        self._delta_squared = policy.delta_m * policy.delta_m
        self._velocity_delta_squared = policy.velocity_delta_m_s * policy.velocity_delta_m_s or math.inf
        self._forget = None if self._events else max(1, round(scenario.sharing.forget_s / scenario.dt))
        self._float = FLOAT_OF_BITS[scenario.radio.bits_per_float]
        self._nowhere = state.at_rest(np.full(scenario.dimensions, FAR_M))
        self._predict = ConstantVelocity(scenario.dt) if predict is None else predict
        self._plausible = plausible(scenario)
        self._leaves = mission.leaves(scenario)
        self._first_leaves = int(self._leaves.min())
        halfway = 0.5 * (state.position(mission.starts(scenario)) + mission.goals(scenario))
        self._origin = state.at_rest(halfway)  # of the numbers that a UAV sends
        self._silence = Broadcast(np.zeros((0, self.numbers), dtype=np.int16), np.zeros(0, dtype=np.intp))

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        """The memory of rows with numbers (M,) at take-off, with the states of the mission plan (N, 4).

        Of the plan a row knows the UAVs that share their states and join the flight in the tick in which it does.
        """
        rows, everyone = len(uavs), len(plan)
        remembered = np.repeat(self._predict.keep(plan, np.arange(everyone), 0).T[None], rows, axis=0)
        joins = mission.joins(self._scenario)
        in_plan = (joins == joins[uavs][:, None]) & ~self._silent  # (M, N): joining with the row, and sharing
        if not in_plan.all():
            remembered = np.where(in_plan[:, None], remembered, self._nowhere[:, None])
        return {
            "neighbour_uav": uavs.astype(np.int32),
            "neighbour_remembered": remembered,  # (M, 4, N)
            "neighbour_tick": np.zeros((rows, everyone), dtype=np.int32),  # of sending
            "neighbour_repeats": np.zeros(
                rows, dtype=np.int32
            ),  # number of ticks in which the state is still to be sent
            "neighbour_unsent": np.zeros(rows, dtype=bool),
        }

    def receive(
        self, memory: Memory, tick: int, received: Sequence[Received], number: int = 0
    ) -> tuple[Memory, NDArray[np.int32]]:
        """Store the states in the frames `number`; implausible states are left out.

        Returns:
            The memory, and the senders of implausible states, ascending, for `Step.refused`.
        """
        frames = of_kind(received, self.numbers, np.int16 if self._events else np.float64, number)
        if self._events:
            frames = [Received(number, f.source, self._decoded(f.payload, f.source), f.links) for f in frames]
        frames, refused = believed(frames, self._plausible)
        if not frames:
            return memory, refused
        remembered, sent_tick = memory["neighbour_remembered"].copy(), memory["neighbour_tick"].copy()
        for states in frames:
            sent, row = states.links.T
            source = states.source[sent]
            remembered[row, :, source] = self._predict.keep(states.payload, states.source, tick - 1)[sent]
            sent_tick[row, source] = tick - 1
        return memory | {"neighbour_remembered": remembered, "neighbour_tick": sent_tick}, refused

    def states(self, memory: Memory, tick: int) -> States:
        """Predicted states of all UAVs in a tick, for each row: (M, N, 4), a view whose columns are contiguous.

        A row's own state is the prediction of its last broadcast. A UAV that is forgotten, or whose group has left the
        flight, is `FAR_M` away, at rest.
        """
        age = tick - memory["neighbour_tick"]
        now = self._predict.now(memory["neighbour_remembered"], age, slice(None), tick)
        states: States = np.swapaxes(now, 1, 2)
        if self._forget is not None and (forgotten := age > self._forget).any():
            states[forgotten] = self._nowhere
        if tick >= self._first_leaves:
            states[:, self._leaves <= tick] = self._nowhere
        return states

    def broadcast_states(self, memory: Memory, tick: int, own: States) -> tuple[Memory, Broadcast]:
        """Returns the memory after the broadcasts of rows (M, 4) in this tick, and the broadcast."""
        if not self._events:
            sent = own.astype(self._float).astype(np.float64)
            return self._sent(memory, tick, np.arange(len(own)), sent), Broadcast(own)
        uav, left = memory["neighbour_uav"], memory["neighbour_repeats"]
        moved, turned = state.squared_halves(own - self._own(memory, tick))
        event = moved > self._delta_squared
        event |= turned > self._velocity_delta_squared
        if joined := bisect_right(self._joins, tick):  # also for a UAV that was paused when the group joined
            event |= memory["neighbour_tick"][np.arange(len(uav)), uav] < self._joins[joined - 1]
        left = np.where(event, self._repeats, left)
        due = left > 0
        rows = due.nonzero()[0]
        if not len(rows):
            return memory | {"neighbour_unsent": due}, self._silence
        numbers = np.rint((own[rows] - self._origin[uav[rows]]) * (1.0 / UNIT))
        fits = np.maximum.reduce(np.abs(numbers), axis=1) <= _MOST
        unsent = np.zeros(len(own), dtype=bool)
        unsent[rows] = ~fits
        memory = memory | {"neighbour_repeats": left - due.astype(np.int32), "neighbour_unsent": unsent}
        rows, payload = rows[fits], numbers[fits].astype(np.int16)
        return self._sent(memory, tick, rows, self._decoded(payload, uav[rows])), Broadcast(payload, rows)

    def unsent(self, memory: Memory) -> Floats:
        """Diagnostic (M, 1): 1 if a row had a state to send in the last tick that exceeds the range of int16."""
        return memory["neighbour_unsent"][:, None].astype(np.float64)

    @cached_property
    def _silent(self) -> Mask:
        """Mask (N,) of the UAVs that never send a state: those of groups whose controllers share none.

        It makes these controllers, because their options may decide it. So no controller may ask in its constructor.
        """
        silent = np.zeros(self._scenario.uavs, dtype=bool)
        if not self._all_share:
            for group, rows in mission.parts(self._scenario):
                own = self._scenario.of_group(group)
                silent[rows] = not plugins.create("controller", own.method, own.controller, own).shares
        return silent

    @cached_property
    def _joins(self) -> list[int]:
        """Ticks in which groups of UAVs that share their states join a flight that has begun, ascending."""
        ticks = mission.joins(self._scenario)
        return sorted(set(ticks[~self._silent].tolist()) - {0})

    def _own(self, memory: Memory, tick: int) -> States:
        """States of the rows that all others predict from the rows' last broadcasts, (M, 4)."""
        uav = memory["neighbour_uav"].astype(np.intp)
        rows = np.arange(len(uav))
        remembered = memory["neighbour_remembered"][rows, :, uav][:, :, None]
        age = tick - memory["neighbour_tick"][rows, uav][:, None]
        return self._predict.now(remembered, age, uav[:, None], tick)[:, :, 0]

    def _sent(self, memory: Memory, tick: int, rows: NDArray[np.intp], states: States) -> Memory:
        """The memory after `rows` have sent states (len(rows), 4)."""
        if not len(rows):
            return memory
        uav = memory["neighbour_uav"][rows].astype(np.intp)
        remembered, sent_tick = memory["neighbour_remembered"].copy(), memory["neighbour_tick"].copy()
        remembered[rows, :, uav] = self._predict.keep(states, uav, tick)
        sent_tick[rows, uav] = tick
        return memory | {"neighbour_remembered": remembered, "neighbour_tick": sent_tick}

    def _decoded(self, numbers: NDArray[np.int16], uavs: NDArray[np.integer]) -> States:
        return numbers * UNIT + self._origin[uavs]


class SharingController(Controller):
    """Base class of controllers that share states: override `fly`, and `init` if it has more memory."""

    shares = True
    pairwise = True
    diagnostics: tuple[str, ...] = ("unsent",)  # after those of `fly`

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._neighbours = NeighbourStates(scenario)
        self._obstacles = Obstacles(scenario)
        self._limits = AltitudeLimits(scenario)
        self.broadcast_numbers = self._neighbours.numbers

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return self._neighbours.init(uavs, plan)

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        memory, refused = self._neighbours.receive(memory, tick, received)
        step = self.fly(memory, own, self._neighbours.states(memory, tick))
        memory, broadcast = self._neighbours.broadcast_states(step.memory, tick, own)
        reported = self._neighbours.unsent(memory)
        if step.diagnostics is not None:
            reported = np.concatenate([step.diagnostics, reported], axis=1)
        return Step(memory, step.acceleration + against_the_air(self.scenario, own), reported, (broadcast,), refused)

    @abstractmethod
    def fly(self, memory: Memory, own: States, others: States) -> Step:
        """Returns memory, acceleration without compensation of drag and wind, and diagnostics.

        Args:
            own: (M, 4). others: (M, N, 4), the states of all UAVs known to each row, as of `NeighbourStates.states`.
        """
        raise NotImplementedError


class Travelling(Options, frozen=True):
    """The options of a travelling controller."""

    speed_m_s: CruiseSpeed = CRUISE_M_S
    slowing_1_s: Slowing = SLOWING_1_S


class TravellingController(SharingController):
    """Base class of controllers that fly like `cruise` without other UAVs; options derive from `Travelling`."""

    guided = True

    stays_inside: ClassVar[bool] = False  # whether a UAV stays where it entered the destination

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._travel = Travel(scenario, options.speed_m_s, options.slowing_1_s, self.stays_inside)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return super().init(uavs, plan) | self._travel.init(uavs)

    def guide(self, memory: Memory, rows: NDArray[np.intp], goals: Vectors) -> Memory:
        return self._travel.guide(memory, rows, goals)
