"""Which way a swarm flies, early and later, from the traced trajectories (claim C7)."""

import numpy as np
from numpy.typing import NDArray

from meanflock.studies.paper.view import View
from meanflock.swarm.scenario import Scenario

Floats = NDArray[np.float64]

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
