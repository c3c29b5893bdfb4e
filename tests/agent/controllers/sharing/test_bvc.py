"""Buffered Voronoi cells: a UAV stays in its cell, and can always stop in it."""

import numpy as np
import pytest

from meanflock.agent.controllers.sharing.bvc import BufferedVoronoi
from meanflock.swarm.scenario import load


@pytest.mark.parametrize("speed", [2.25, 4.0])
def test_two_uavs_head_on_stop_in_their_cells(speed: float) -> None:
    scenario = load(None, ["uavs=2", "wind.sigma=0", "wind.drag=0", "vehicle.acceleration_max=3"])
    options = BufferedVoronoi.Options(radius_m=0.5, right_bias=0.0, velocity_gain_1_s=4.0, speed_m_s=speed)
    controller = BufferedVoronoi(options, scenario)
    own = np.array([[10.0, 0.0, speed, 0.0], [30.0, 0.0, -speed, 0.0]])
    memory = controller.init(np.arange(2), own) | {"travel_end": np.array([[40.0, 0.0], [0.0, 0.0]])}
    for _ in range(150):
        everyone = np.repeat(own[None], 2, axis=0)
        acceleration = controller.fly(memory, own, everyone).acceleration
        assert (np.linalg.norm(acceleration, axis=1) <= 3.0 + 1e-9).all()
        own = np.concatenate([own[:, :2] + 0.1 * own[:, 2:], own[:, 2:] + 0.1 * acceleration], axis=1)
        assert own[0, 0] < 20.0 - 0.35  # the lag of the velocity carries it up to 11 cm beyond
    assert own[1, 0] - own[0, 0] == pytest.approx(1.0, abs=0.1)
