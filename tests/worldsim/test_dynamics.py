"""Motion: exact limits without noise, exact moments with it, and the order at which the integrator converges."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario, load
from meanflock.worldsim.vehicles.point_mass import PointMass

ORACLE = json.loads((Path(__file__).parents[1] / "oracle" / "wind.json").read_text())
ROWS = 4000


def scenario(
    dt: float = 0.1, sigma: float = 0.1, drag: float = 0.1, mean: tuple[float, float] = (1.0, -1.0)
) -> Scenario:
    return load(None, [f"dt={dt}", f"wind.sigma={sigma}", f"wind.drag={drag}", f"wind.mean={list(mean)}"])


def moved_by(flown: Scenario, states: state.States, command: Any, noise: Any) -> state.States:
    """One tick of the point mass."""
    return PointMass(PointMass.Options(), flown).step(states, {}, command, noise)[0]


def fly(flown: Scenario, states: state.States, acceleration: Any, ticks: int, seed: int = 1) -> state.States:
    draw = np.random.default_rng(seed)
    command = np.broadcast_to(np.asarray(acceleration, dtype=float), (*states.shape[:-1], 2))
    for _ in range(ticks):
        states = moved_by(flown, states, command, draw.standard_normal(command.shape))
    return states


def test_without_wind_and_drag_a_constant_acceleration_is_integrated_exactly() -> None:
    flown, n, a = scenario(dt=0.125, sigma=0, drag=0), 64, np.array([0.5, -2.0])
    start = np.array([1.0, 2.0, 3.0, -4.0])
    end = fly(flown, start, a, n)
    np.testing.assert_array_equal(end[state.VELOCITY], start[state.VELOCITY] + n * 0.125 * a)
    # The new velocity moves the position: Σ v_k dt = n v0 dt + n(n+1)/2 a dt².
    expected = start[state.POSITION] + n * 0.125 * start[state.VELOCITY] + n * (n + 1) / 2 * 0.125**2 * a
    np.testing.assert_array_equal(end[state.POSITION], expected)


@pytest.mark.parametrize("case", ORACLE, ids=lambda case: f"{case['t_s']}s")
def test_mean_and_variance_are_those_of_the_ornstein_uhlenbeck_wind(case: dict[str, Any]) -> None:
    dt = {1.0: 0.01, 10.0: 0.02, 50.0: 0.05}[case["t_s"]]
    end = fly(scenario(dt=dt), np.zeros((ROWS, 4)), 0.0, round(case["t_s"] / dt))
    for part, name in ((state.VELOCITY, "velocity"), (state.POSITION, "position")):
        mean, variance = np.array(case[f"{name}_mean"]), case[f"{name}_variance"]
        error = np.abs(end[:, part].mean(axis=0) - mean) / math.sqrt(variance / ROWS)
        assert (error < 4).all(), (name, error)
        error = np.abs(end[:, part].var(axis=0) - variance) / (variance * math.sqrt(2 / ROWS))
        assert (error < 4).all(), (name, error)
    across = np.corrcoef(end[:, state.VX], end[:, state.VY])[0, 1]
    assert abs(across) < 4 / math.sqrt(ROWS)
