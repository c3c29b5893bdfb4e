"""The flight of one swarm: states, wind, energy, arrivals and encounters, tick by tick, without bus or clock."""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.kernels.all_pairs import MANY
from meanflock.swarm import mission, state
from meanflock.swarm.events import (
    Arrived,
    Collided,
    Diverged,
    FlightEvent,
    Grounded,
    HitObstacle,
    Landed,
    LeftAltitudes,
    Lost,
    Rejoined,
)
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask
from meanflock.swarm.stateful import Stateful
from meanflock.swarm.wire.messages import Status
from meanflock.worldsim.alignment import EXACT, speed_difference
from meanflock.worldsim.altitude import Altitude
from meanflock.worldsim.books import Books, Noise
from meanflock.worldsim.encounters import Encounters, pairs
from meanflock.worldsim.ground import Ground
from meanflock.worldsim.group_measures import GroupMeasures
from meanflock.worldsim.guide import Guide
from meanflock.worldsim.vehicles.flown import FlownVehicles

FASTEST_M_S = 1e4  # beyond it no UAV of a large swarm has a segment: many of them would be near all others

# Numbers of the array's own type: comparing with a member of the enumeration converts it each time.
FLYING = np.uint8(Status.FLYING)
ARRIVED = np.uint8(Status.ARRIVED)
LANDED = np.uint8(Status.LANDED)
LOST = np.uint8(Status.LOST)


class Flight(Stateful):
    """All quantities of the UAVs. Arrays have one row a UAV.

    `states` and the arrays of `hidden` are new after every tick. `on_way`, `lost`, `waiting` and `idle` are new
    when a UAV changes sides. Sums over the ticks are in the books, which are settled when one is read.

    Attributes:
        states: (N, 2d), positions and velocities in m and m/s.
        hidden: the vehicle's hidden state.
        status: (N,), FLYING, ARRIVED, LANDED or LOST.
        on_way: (N,), UAVs that have left the ground, have not arrived and are not lost.
        lost: (N,), UAVs that are out of the mission.
        waiting: (N,), UAVs on the ground: they have not left it yet, were lost there, or have landed; None for no UAV.
        lost_on_ground: (N,), UAVs that were lost before their first tick in the air; they stay on the ground unless
            they rejoin.
        off: (N,), UAVs that take no part: they are lost, have landed, or have not joined; None for no UAV.
        idle: (N,), UAVs whose commands have no effect: those on the ground, and lost ones; None for no UAV.
        books: sums of energy, distance, effort and speed.
        noise: of the motion.
        guide: the goals.
        ground: of a flight in space. altitude: its floor and ceiling.
        by_group: measures of each group; None without groups.
        arrival_tick: (N,), -1 before arrival.
        arrival_energy: (N,), J until arrival.
        steps: number of commands of UAVs that are not off, one for each UAV and tick. off_ticks: (N,), ticks in which a
            UAV was off.
        clipped: number of commands, one for each UAV and tick, that were longer than the vehicle's limit.
        launch_tick: (N,), tick in which a UAV leaves the ground.
        speed_difference_sum: sum over ticks 0…tick of the mean ‖v_j − v_i‖ over pairs, m/s.
        speed_difference_squared_error: squared standard error of that sum, m²/s²; 0 if all pairs were measured.
        near_sum: sum over ticks of the number of pairs i < j within the hazard radius.
        last_arrival: tick of the last arrival so far; -1 for none.
        events: events of the last tick; the owner empties the list.
    """

    stored = (
        *(
            "tick",
            "steps",
            "off_ticks",
            "clipped",
            "speed_difference_sum",
            "speed_difference_squared_error",
            "near_sum",
        ),
        *("states", "hidden", "status", "lost_on_ground", "arrival_tick", "arrival_energy", "books", "encounters"),
        *("ground", "altitude", "noise", "guide", "by_group"),
    )

    def __init__(self, scenario: Scenario) -> None:
        n = scenario.uavs
        self.scenario = scenario
        self.tick = 0
        self.steps = 0
        self.off_ticks = np.zeros(n, dtype=np.int64)
        self.clipped = 0
        self.speed_difference_sum = 0.0
        self.speed_difference_squared_error = 0.0
        self.near_sum = 0
        self.events: list[FlightEvent] = []
        self._vehicles = FlownVehicles(scenario)
        self.states: state.States = mission.starts(scenario)
        self.hidden = self._vehicles.init()
        self.encounters = Encounters(scenario)
        self.ground = Ground(scenario)
        self.altitude = Altitude(scenario)
        self.guide = Guide(scenario)
        self.by_group = GroupMeasures(scenario) if scenario.groups else None
        radii = mission.radii(scenario)
        # Radii of arrival and the UAVs (N,) that have them; None: all.
        self._discs: list[tuple[float, Mask | None]] = [(float(radii[0]), None)]
        if (radii != radii[0]).any():
            self._discs = [(float(radius), radii == radius) for radius in np.unique(radii)]
        self.launch_tick = mission.launches(scenario)
        self._join_tick = mission.joins(scenario)
        self.status = np.full(n, FLYING)
        self.lost_on_ground = np.zeros(n, dtype=bool)
        self.arrival_tick = np.full(n, -1)
        self.arrival_energy = np.zeros(n)
        self.last_arrival = -1
        self.books = Books(scenario, self._vehicles, self.states)
        self.noise = Noise(scenario)
        self._max_ticks = scenario.max_ticks
        self._ends_with_arrivals = scenario.stop == "arrival"
        self._sort()
        self._observe(self.states, self.on_way)

    @property
    def time_s(self) -> float:
        """Simulated time, s."""
        return self.tick * self.scenario.dt

    @property
    def phi_a(self) -> float:
        """φ_A(t): mean over time and all N² pairs of ‖v_j − v_i‖, m/s."""
        return self.speed_difference_sum / (self.tick + 1)

    @property
    def phi_a_standard_error(self) -> float | None:
        """Standard error of φ_A(t) by the sampling of pairs, m/s; None of a swarm in which all pairs are measured."""
        if self.scenario.uavs <= EXACT:
            return None
        return math.sqrt(self.speed_difference_squared_error) / (self.tick + 1)

    @property
    def phi_c(self) -> float:
        """φ_C(t) as printed, the pairs i = j included: never below 1/N."""
        n = self.scenario.uavs
        return (2.0 * self.near_sum / (self.tick + 1) + n) / n**2

    @property
    def phi_c_distinct(self) -> float | None:
        """φ_C(t) over distinct pairs only; None for a swarm of one."""
        n = self.scenario.uavs
        return 2.0 * self.near_sum / (self.tick + 1) / (n * (n - 1)) if n > 1 else None

    @property
    def energy(self) -> state.Rows:
        """(N,), J since take-off."""
        self.books.settle()
        return self.books.energy

    @property
    def distance(self) -> state.Rows:
        """(N,), m flown until arrival."""
        self.books.settle()
        return self.books.distance

    @property
    def effort(self) -> state.Rows:
        """(N,), sum of ‖a‖² over the ticks until arrival, a as commanded within the vehicle's limit, m²/s⁴."""
        self.books.settle()
        return self.books.effort

    @property
    def speed_max(self) -> float:
        """Largest speed of a UAV on the way, m/s."""
        self.books.settle()
        return self.books.speed_max

    @property
    def mean_speed(self) -> float | None:
        """Mean over UAVs and ticks on the way, m/s."""
        ticks = self.ticks_on_way
        return float(self.books.speed_sum.sum()) / ticks if ticks else None

    @property
    def ticks_on_way(self) -> int:
        """Ticks that UAVs were on the way, summed over UAVs."""
        self.books.settle()
        return int(self.books.ticks_on_way.sum())

    @property
    def trajectory_sha256(self) -> str:
        """Hash of the states of ticks 0…tick, as little-endian float64."""
        self.books.settle()
        return self.books.hexdigest

    @property
    def over(self) -> bool:
        """Returns whether the mission has ended."""
        return self.tick >= self._max_ticks or (self._ends_with_arrivals and not self._any_flying)

    @property
    def collisions(self) -> int:
        """Number of pairs that collided while both were on the way."""
        return len(self.encounters.collided)

    def lose(self, uavs: NDArray[np.intp], event: type[Lost | Diverged], reason: str) -> None:
        """Take UAVs out of the mission. Those in the air fly on without commands; the flight waits for none of them."""
        uavs = uavs[(self.status[uavs] != LOST) & (self.status[uavs] != LANDED)]
        if len(uavs):
            self.status[uavs] = LOST
            self.lost_on_ground[uavs] = self.launch_tick[uavs] >= max(1, self.tick)  # in tick 0 all others are aloft
            self._sort()
            self.events.append(event(self.tick, tuple(uavs.tolist()), reason))

    def rejoin(self, uavs: NDArray[np.intp], node: str) -> None:
        """Take lost UAVs back into the mission, with a new controller. Arrived UAVs keep that status."""
        uavs = uavs[self.status[uavs] == LOST]
        if len(uavs):
            self.status[uavs] = np.where(self.arrival_tick[uavs] >= 0, ARRIVED, FLYING)
            self.lost_on_ground[uavs] = False
            self._sort()
            self.guide.forget(uavs)
            self.events.append(Rejoined(self.tick, tuple(uavs.tolist()), node))

    def land(self, uavs: NDArray[np.intp], reason: str) -> None:
        """Land UAVs where they are, for good; lost ones fly on."""
        uavs = uavs[self.status[uavs] != LOST]
        if len(uavs):
            self.states = self.states.copy()
            state.velocity(self.states)[uavs] = 0.0
            if self.scenario.dimensions == state.SPACE:
                self.states[uavs, state.PLANE] = 0.0
            self.status[uavs] = LANDED
            self._sort()
            self.events.append(Landed(self.tick, tuple(uavs.tolist()), reason))

    def advance(self, accelerations: state.Vectors, gust: state.Vectors | None = None) -> None:
        """Fly one tick.

        UAVs on the ground stay at rest and spend no energy.

        Args:
            accelerations: (N, d), m/s², the commands. Those of lost UAVs have no effect.
            gust: (N, d), m/s², the acceleration by gusts of every UAV in flight, lost UAVs included.
        """
        on_way = self.on_way
        waiting = self.waiting
        if self.idle is not None:
            accelerations = np.where(self.idle[:, None], 0.0, accelerations)
        if (limit := self._vehicles.limit) is not None:
            accelerations = self._limited(accelerations, limit)
        self.steps += len(accelerations)
        if self.off is not None:
            self.steps -= int(np.count_nonzero(self.off))
            self.off_ticks += self.off
        felt = self._vehicles.felt(accelerations, gust)
        before = self.states if waiting is None else np.where(waiting[:, None], np.nan, self.states)
        moved = self._vehicles.step(self.states, self.hidden, felt, self.noise.next(), waiting, gust)
        self.tick += 1
        self.states = self.ground.above(moved.states) if self.ground.is_there else moved.states
        self.hidden = moved.hidden
        diverged = moved.diverged
        if len(diverged):
            accelerations, felt, before = accelerations.copy(), felt.copy(), before.copy()
            accelerations[diverged] = felt[diverged] = 0.0
            before[diverged] = np.nan
        self.books.add(self.states, self.hidden, accelerations, felt, on_way, waiting)
        if len(diverged):
            self.lose(diverged, Diverged, "left every bound")
        if waiting is not None and ((self.launch_tick == self.tick) | (self._join_tick == self.tick)).any():
            self._sort()
        self._observe(before, on_way)
        self._arrive(on_way, diverged)
        if not (self.ground.is_there or self.altitude.limits):
            return
        down = (self.arrival_tick >= 0) | (self.status == LANDED)
        if self.ground.is_there:
            for uav in self.ground.touch(self.states, down).tolist():
                self.events.append(Grounded(self.tick, uav))
        if self.altitude.limits:
            for uav, limit in self.altitude.leave(self.states, down):
                side, limit_m = self.altitude.limits[limit]
                self.events.append(LeftAltitudes(self.tick, uav, side > 0.0, limit_m))

    def shown(self) -> Floats:
        """The numbers (N, C) that the vehicles show of the UAVs."""
        return self._vehicles.shown(self.hidden)

    def restored(self) -> None:
        self._sort()
        self.last_arrival = int(self.arrival_tick.max())

    def rehash(self, history: Floats) -> None:
        """Continue the hash with the states (tick + 1, N, 2d) of all ticks, which no checkpoint has.

        Raises:
            ValueError: they do not end in the states of this tick.
        """
        if history.shape != (self.tick + 1, *self.states.shape) or history[-1].tobytes() != self.states.tobytes():
            raise ValueError(f"the time series does not end in the states of tick {self.tick}")
        self.books.rehash(history)

    def _sort(self) -> None:
        """Sort the UAVs anew by what they do: their status has changed, or some leave the ground."""
        flying = self.status == FLYING
        lost, landed = self.status == LOST, self.status == LANDED
        waiting = landed | self.lost_on_ground | (self.launch_tick > self.tick)
        off = lost | landed | (self._join_tick > self.tick)
        self._any_flying = bool(flying.any())
        is_waiting = bool(waiting.any())
        self.waiting: Mask | None = waiting if is_waiting else None
        self.off: Mask | None = off if off.any() else None
        self.idle: Mask | None = waiting | lost if is_waiting or self.off is not None else None
        self.lost: Mask = lost
        self.on_way: Mask = flying & ~waiting

    def _limited(self, accelerations: state.Vectors, limit: Floats | float) -> state.Vectors:
        """Commands (N, d), those longer than the limit shortened to it and counted, m/s²."""
        length = functools.reduce(np.hypot, state.parts(accelerations))
        longer = length > limit * (1.0 + 1e-9)  # a controller may have shortened its command to the limit itself
        if not (count := int(np.count_nonzero(longer))):
            return accelerations
        self.clipped += count
        factors = np.divide(limit, length, out=np.ones_like(length), where=longer)
        return accelerations * factors[:, None]

    def _observe(self, before: state.States, on_way: NDArray[np.bool_]) -> None:
        """Measure the tick that led to `states`.

        Args:
            before: (N, 2d), states at its begin; NaN for UAVs that flew no segment: they were on the ground or were put
                back.
            on_way: (N,), UAVs that were on the way then.
        """
        after = aloft = self.states
        if (waiting := self.waiting) is not None:
            after, aloft = np.where(waiting[:, None], np.nan, after), after[~waiting]
        difference = speed_difference(aloft, self.scenario.seed, self.tick)
        self.speed_difference_sum += difference.mean
        self.speed_difference_squared_error += difference.squared_error
        if self.scenario.uavs > MANY and (is_fast := state.speed(after) > FASTEST_M_S).any():
            before = np.where(is_fast[:, None], np.nan, before)
        seen = pairs(self.scenario.metrics, before, after, self.encounters.nearest_m, self.encounters.expected)
        self.near_sum += seen.near
        if self.by_group is not None:
            self.by_group.observe(self.tick, before, after, waiting)
        for first, second in self.encounters.meet(seen, on_way, after):
            self.events.append(Collided(self.tick, first, second))
        for uav, disc in self.encounters.enter(before, after):
            self.events.append(HitObstacle(self.tick, uav, disc))

    def _arrive(self, on_way: Mask, diverged: NDArray[np.intp]) -> None:
        """Change the status of UAVs that were `on_way` (N,), did not diverge, and have reached the destination."""
        if self.guide.is_there:
            on_way = on_way | (self.guide.homeward & (self.status == ARRIVED))
        found, reached = 0, on_way.copy()
        for radius, uavs in self._discs:
            own = reached if uavs is None else on_way & uavs
            found += kernels.reached(self.states, self.guide.goals, radius, own)
            if uavs is not None:
                reached[uavs] = own[uavs]
        if not found:
            return
        reached[diverged] = False
        new = np.flatnonzero(reached)
        if self.guide.is_there:
            new = self.guide.reach(new, self.tick)
            if not len(new):
                return
        self.status[new] = ARRIVED
        self.arrival_tick[new] = self.last_arrival = self.tick
        self.arrival_energy[new] = self.energy[new]
        self._sort()
        self.events.append(Arrived(self.tick, tuple(new.tolist())))
