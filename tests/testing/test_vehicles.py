"""The suite for vehicles lets ours and one with a hidden state through."""

import numpy as np
import pytest

import meanflock as mf
from meanflock.swarm import plugins
from meanflock.testing import check_vehicle


@pytest.mark.parametrize("name", plugins.names("vehicle"))
def test_every_vehicle_of_ours_conforms(name: str) -> None:
    check_vehicle(plugins.load("vehicle", name))


class Tiring(mf.Vehicle):
    """A vehicle with a battery, whose `init` is given how many UAVs there are, as in a flight."""

    name = "tiring"

    def __init__(self, options: mf.Vehicle.Options, scenario: mf.Scenario) -> None:
        self._dt = scenario.dt

    def init(self, uavs: int) -> dict[str, np.ndarray]:
        return {"charge": np.ones(uavs)}

    def step(
        self, states: np.ndarray, hidden: dict[str, np.ndarray], acceleration: np.ndarray, noise: np.ndarray
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        velocity = states[:, 2:] + self._dt * hidden["charge"][:, None] * acceleration
        moved = np.concatenate([states[:, :2] + self._dt * velocity, velocity], axis=-1)
        return moved, {"charge": hidden["charge"] * 0.99}

    def power(self, states: np.ndarray, hidden: dict[str, np.ndarray], acceleration: np.ndarray) -> np.ndarray:
        return 1.0 + hidden["charge"]


def test_a_vehicle_with_a_hidden_state_conforms() -> None:
    check_vehicle(Tiring)
