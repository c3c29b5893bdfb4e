"""The flights of the study and what is measured of each: the swarm at three times, and the cost of the last UAV."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.mean_field import learner
from meanflock.kernels.mean_field import features, hjb, interaction
from meanflock.kernels.mean_field.layout import DENSITY, DENSITY_FEATURES
from meanflock.launch.engine import Engine
from meanflock.studies.study import of_all
from meanflock.swarm import mission, scenario, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status
from meanflock.worldsim.tick import Row

Floats = NDArray[np.float64]

METHOD = "mfgfl-hf"
BEGINNING = "beginning"  # a flight of the first 20 s
TIMES_S = (5.0, 10.0, 20.0)
CENTRES = {  # mean state of 1,000 UAVs of seed 95200 at these times: nodes at which φ_G is compared lie around it
    5.0: (145.9, 96.2, -1.5, -1.1),
    10.0: (137.0, 89.2, -2.0, -1.6),
    20.0: (115.4, 70.6, -2.2, -2.0),
}
# The paper's mission from a square of 80 m by 80 m, whatever N is. UAVs start at random places of a lattice whose step
# is more than the radius of a collision, and which has so many places that the starts are almost independent.
SIDE, STEP = 640, 0.125  # places along an edge, and the distance of two, m
CORNER = (110.0, 60.0)
# Rounds every 5 s, so that the first 20 s have some; scales of the features that do not follow the starts.
SETTINGS = ("federation.period=50", "learner.position_scale=200")
DIRECTIONS, LEVELS = 16, 200  # of projections, and of their quantiles


class SwarmCase(NamedTuple):
    """A case of the study: N, and the beginning of a flight or the controller of the last UAV in a whole one."""

    uavs: int
    flight: str


def flight(case: SwarmCase, seed: int) -> Scenario:
    """One flight of a case. A seed has the same starts and the same wind, whichever controller the last UAV has."""
    settings: dict[str, Any] = {"start.positions": starts(case.uavs, seed)}
    if case.flight == BEGINNING:
        settings |= {"duration": TIMES_S[-1], "stop": "duration"}
    else:
        swarm, last = {"name": "swarm", "count": case.uavs - 1}, {"name": "last", "count": 1, "method": case.flight}
        settings |= {"groups": [swarm, last]}
    return scenario.load(None, SETTINGS, method=METHOD, uavs=case.uavs, seed=seed).replace(**settings)


def starts(uavs: int, seed: int) -> tuple[tuple[float, float], ...]:
    """Places of a lattice, each at most once, drawn by seed and N."""
    place = np.random.default_rng([seed, uavs]).choice(SIDE**2, uavs, replace=False)
    x, y = (start + STEP * index for start, index in zip(CORNER, (place % SIDE, place // SIDE), strict=True))
    return tuple(zip(x.tolist(), y.tolist(), strict=True))


def measure(flown: Scenario) -> dict[str, Any]:
    """Fly a scenario; its summary in short, and what its kind of flight is for."""
    return whole(flown) if flown.groups else beginning(flown)


def beginning(flown: Scenario) -> dict[str, Any]:
    """Fly the first seconds; quantiles of projections, and φ_G of the true states and of the learned density."""
    engine, seen = Engine(flown, f"limit-{flown.uavs}"), Snapshots(flown)
    summary = engine.complete(seen.look)
    return {
        "energy_J": summary["energy_mean_J"],
        "phi_A": summary["phi_A"],
        "collisions": summary["collisions_all"],
        "lost": summary["lost"],
        "positions": np.stack(seen.positions).astype("<f4").tobytes(),
        "velocities": np.stack(seen.velocities).astype("<f4").tobytes(),
        "phi_G": np.stack(seen.phi_g).tobytes(),
        "phi_G_learned": np.stack(seen.learned).tobytes(),
        "trajectory_sha256": summary["trajectory_sha256"],
    }


class Snapshots:
    """Observer of a flight at the times that are compared."""

    def __init__(self, flown: Scenario) -> None:
        self._ticks = {round(time / flown.dt): CENTRES[time] for time in TIMES_S}
        self._cost, self._tables = flown.cost, learner.tables(flown)
        self._offsets = learner.offsets(flown.density, flown.dimensions)
        self.positions: list[Floats] = []
        self.velocities: list[Floats] = []
        self.phi_g: list[Floats] = []
        self.learned: list[Floats] = []

    def look(self, engine: Engine) -> None:
        """Take what is compared, if it is time."""
        if engine.world.tick not in self._ticks:
            return
        states, nodes = engine.world.flight.states, self._ticks[engine.world.tick] + self._offsets
        self.positions.append(quantiles(state.position(states)))
        self.velocities.append(quantiles(state.velocity(states)))
        self.phi_g.append(
            np.concatenate(
                [interaction.empirical(node, states, self._cost.epsilon, self._cost.beta) for node in nodes[:, None]]
            )
        )
        weights = engine.models[:, DENSITY][:, :DENSITY_FEATURES].mean(axis=0)
        terms = features.density(self._tables, nodes)
        self.learned.append(interaction.quadrature(self._tables, np.tile(weights, (len(nodes), 1)), terms))


def quantiles(points: Floats) -> Floats:
    """Quantiles (K, L) of points (N, 2) along K directions, evenly over the half circle, at L levels."""
    angle = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    levels = (np.arange(LEVELS) + 0.5) / LEVELS
    along = np.sort(np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ points.T, axis=-1)
    return along[:, np.floor(levels * len(points)).astype(np.intp)]


def whole(flown: Scenario) -> dict[str, Any]:
    """Fly the whole mission; times, energies, and the cost of the last UAV until it arrives."""
    engine, last = Engine(flown, f"limit-{flown.uavs}-{flown.groups[-1].method}"), LastCost(flown)
    engine.add_sink(last)
    summary = of_all(flown, engine.complete())
    return {
        "time_s": summary["t_avg_censored_s"],
        "energy_J": summary["energy_mean_J"],
        "phi_A": summary["phi_A"],
        "collisions": summary["collisions_all"],
        "arrived": summary["arrived"],
        "lost": summary["lost"],
        "last_cost_m": last.cost,
        "last_time_s": summary["groups"]["last"]["t_avg_s"] or flown.max_ticks * flown.dt,
        "last_energy_J": summary["groups"]["last"]["energy_mean_J"],
        "trajectory_sha256": summary["trajectory_sha256"],
    }


class LastCost:
    """Sink that integrates the running cost φ_L + c2 φ_G + c3‖a‖² of the last UAV until it arrives; φ_G is that of the
    true states."""

    def __init__(self, flown: Scenario) -> None:
        self._constants, self._dt = flown.cost, flown.dt
        self._states = mission.starts(flown)
        self.cost, self._flies = 0.0, True

    def write(self, row: Row) -> None:
        """Add the cost of the tick that led to a row."""
        if row.tick and self._flies:
            given, states = self._constants, self._states
            phi_g = interaction.empirical(states[-1:], states, given.epsilon, given.beta)
            command = row.accelerations[-1:].astype(np.float64)
            running = hjb.local_cost(states[-1:], given.c1) + given.c2 * phi_g + given.c3 * state.dot(command, command)
            self.cost += self._dt * float(running[0])
        self._states, self._flies = row.states, row.status[-1] == Status.FLYING
