"""One traced flight as arrays: states, φ_G along the way, and where UAVs collided."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.mean_field import interaction
from meanflock.studies.paper.view import View
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status

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
        """When the last UAV arrived or was lost, or the end of the flight if one never did, s."""
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
    states = np.full((len(times), uav.max() + 1, state.SIZE), np.nan)
    for k, column in enumerate(("x_m", "y_m", "vx_m_s", "vy_m_s")):
        states[row, uav, k] = frame[column]
    status = np.zeros(states.shape[:2], dtype=np.uint8)
    status[row, uav] = frame["status"].astype(np.uint8)
    return Trace(times, states, status)


def interaction_term(flown: Trace) -> Floats:
    """φ_G of every UAV among the true states of all, `(T, N)`, m²/s² over m²."""
    cost = Scenario().cost
    return np.stack([interaction.empirical(states, states[None], cost.epsilon, cost.beta) for states in flown.states])


def collisions(flown: Trace) -> Floats:
    """Where and when each pair first came within r_coll, both on the way: rows (t in s, x in m, y in m), at the end of
    the tick in which it did.

    A trace has every second tick. The tick between is not lost: a position is the one before plus dt times the new
    velocity, so r(k − 1) = r(k) − dt v(k), exactly.
    """
    position, velocity = flown.states[..., state.POSITION], flown.states[..., state.VELOCITY]
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
