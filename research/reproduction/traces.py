"""Traced flights as arrays: states, φ_G along the way, collisions, and the direction of flight (claim C7)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.mean_field import interaction
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status
from research.reproduction.tables import View

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Trace:
    """times (T,), s. states (T, N, 4). status (T, N)."""

    times: Floats
    states: Floats
    status: NDArray[np.uint8]

    def until(self, seconds: float) -> "Trace":
        """The part up to a time."""
        end = int(np.searchsorted(self.times, seconds + 1e-6))
        return Trace(self.times[:end], self.states[:end], self.status[:end])

    @property
    def mission_s(self) -> float:
        """Time at which the last UAV arrived or was lost, s; the end of the flight if one still flies."""
        flying = (self.status == Status.FLYING).any(axis=-1)
        return float(self.times[-1] if flying[-1] else self.times[np.argmin(flying)])


def trace(view: View, experiment: str, method: str, **coordinates: object) -> Trace | None:
    """The traced flight of a method, or None; `coordinates` as in `Frame.where`."""
    if not len(view.trajectories):
        return None
    frame = view.trajectories.where(experiment=experiment, method=method, **coordinates)
    if not len(frame):
        return None
    times, row = np.unique(frame["t_s"], return_inverse=True)
    uav = frame["uav"].astype(np.intp)
    columns = ("x_m", "y_m", "vx_m_s", "vy_m_s")
    states = np.full((len(times), uav.max() + 1, len(columns)), np.nan)
    for k, column in enumerate(columns):
        states[row, uav, k] = frame[column]
    status = np.zeros(states.shape[:2], dtype=np.uint8)
    status[row, uav] = frame["status"].astype(np.uint8)
    return Trace(times, states, status)


def interaction_term(flown: Trace) -> Floats:
    """φ_G of every UAV among the true states of all, `(T, N)`, m²/s² over m²."""
    cost = Scenario().cost
    return np.stack([interaction.empirical(states, states[None], cost.epsilon, cost.beta) for states in flown.states])


def collisions(flown: Trace) -> Floats:
    """First collisions of pairs on the way: rows (t in s, x in m, y in m), at the end of the tick.

    A trace has every second tick. The tick between is not lost: a position is the one before plus dt times the new
    velocity, so r(k − 1) = r(k) − dt v(k), exactly.
    """
    position, velocity = state.position(flown.states), state.velocity(flown.states)
    dt, radius = Scenario().dt, Scenario().metrics.collision_radius
    met: dict[tuple[int, int], tuple[float, float, float]] = {}
    before = position[0]
    for k in range(len(flown.times)):
        on_way = flown.status[max(k - 1, 0)] == Status.FLYING
        for back in (1, 0) if k else (0,):
            here = position[k] - back * dt * velocity[k]
            squared = state.approach(before[:, None] - before[None], here[:, None] - here[None])
            close = np.triu(squared < radius * radius, 1) & on_way[:, None] & on_way[None]
            for i, j in np.argwhere(close).tolist():
                middle = (here[i] + here[j]) / 2
                met.setdefault((i, j), (float(flown.times[k] - back * dt), float(middle[0]), float(middle[1])))
            before = here
    return np.array(sorted(met.values())).reshape(-1, 3)


# -- direction of flight -----------------------------------------------------------------------------------------------


EARLY_S = (0.0, 10.0)
LATER_S = (60.0, 100.0)


def positions(view: View, method: str, time_s: float) -> Floats:
    """Positions of the traced S0 run of a method at an instant, `(N, 2)`, m; empty without a trace."""
    if not len(view.trajectories):
        return np.zeros((0, 2))
    frame = view.trajectories.where(experiment="s0", method=method, t_s=float(time_s))
    order = np.argsort(frame["uav"])
    return np.stack([frame["x_m"], frame["y_m"]], axis=-1)[order]


def cosine(first: Floats, second: Floats) -> Floats:
    """Cosine of the angle between the rows of two arrays `(N, 2)`."""
    lengths = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
    return (first * second).sum(axis=-1) / lengths


def turn(view: View, method: str, metric: str) -> list[float]:
    """One number a UAV: `cosine_wind_early`, of the early displacement with the mean wind of the paper's scenario, or
    `cosine_home_later`, of the later displacement with the way to the origin as it starts.
    """
    if metric not in ("cosine_wind_early", "cosine_home_later"):
        raise ValueError(f"`metric` is {metric!r}; it is cosine_wind_early or cosine_home_later")
    early = metric == "cosine_wind_early"
    since, until = (positions(view, method, time_s) for time_s in (EARLY_S if early else LATER_S))
    if not len(since) or len(since) != len(until):
        return []
    aim = np.broadcast_to(np.array(Scenario().wind.mean), since.shape) if early else -since
    return [float(value) for value in cosine(until - since, aim)]
