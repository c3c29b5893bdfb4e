"""Optimal reciprocal collision avoidance: velocities of another implementation, and a swap."""

from typing import Any

import numpy as np
import pyrvo
import pytest

from meanflock.agent.controllers.sharing.orca import Orca
from meanflock.swarm.scenario import Scenario

SPEED_MAX = 4.0


def by_pyrvo(own: np.ndarray, wished: np.ndarray, radius: float, horizon: float) -> np.ndarray:
    simulator = pyrvo.RVOSimulator(0.1, 15.0, 10, horizon, horizon, radius / 2.0, SPEED_MAX)
    for number, (state, velocity) in enumerate(zip(own.tolist(), wished.tolist(), strict=True)):
        simulator.add_agent((state[0], state[1]))
        simulator.set_agent_velocity(number, (state[2], state[3]))
        simulator.set_agent_pref_velocity(number, (velocity[0], velocity[1]))
    simulator.do_step()
    return np.array([tuple(simulator.get_agent_velocity(number).to_tuple()) for number in range(len(own))])


def ours(own: np.ndarray, wished: np.ndarray, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    made = Orca(Orca.Options(speed_max_m_s=SPEED_MAX, **options), Scenario(uavs=len(own)))
    return made.velocity(own, np.repeat(own[None], len(own), axis=0), np.arange(len(own)), wished)


@pytest.mark.parametrize(("radius", "horizon"), [(0.7, 1.0), (0.9, 3.0)])
@pytest.mark.parametrize("spread", [1.0, 2.5, 6.0])  # most touch; some do; few are near
def test_velocities_are_those_of_pyrvo(radius: float, horizon: float, spread: float) -> None:
    """10⁴ and more; it computes in single precision, and takes for parallel what is 1e-5 apart."""
    draw = np.random.default_rng(int(10 * spread + horizon))
    errors, feasible = [], []
    while len(errors) < 1700:
        uavs = int(draw.integers(2, 9))
        own = draw.normal(size=(uavs, 4)) * [spread, spread, 1.5, 1.5]
        wished = 1.5 * draw.normal(size=(uavs, 2))
        velocity, missing = ours(own, wished, radius_m=radius, horizon_s=horizon)
        errors += np.linalg.norm(velocity - by_pyrvo(own, wished, radius, horizon), axis=1).tolist()
        feasible += (missing <= 0.0).tolist()
    assert np.median(errors) < 3e-7
    assert sum(feasible) > 400
    assert np.quantile(np.array(errors)[feasible], 0.99) < 1e-4
    assert np.quantile(errors, 0.95) < 1e-2
