"""The mean wind: a field with the size, length and divergence it should have; what it costs; who is told of it."""

import math

import numpy as np
import pytest

from meanflock.federation.fragments import resolved
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import decode, encode, load
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.vehicles.base import MeanWind
from meanflock.worldsim.vehicles.point_mass import PointMass
from tests.worldsim.flights import power

FIELD = ("wind.field_rms=1.5", "wind.field_length=20", "wind.mean=[0.5, -2.0]")


def at(*places: tuple[float, float]) -> state.States:
    return np.array([[x, y, 0.0, 0.0] for x, y in places])


def test_over_a_large_area_the_field_has_its_mean_and_size() -> None:
    sizes, means = [], []
    for seed in range(1, 9):
        wind, draw = MeanWind(load(None, [*FIELD, f"seed={seed}"])), np.random.default_rng(seed)
        over = wind(np.concatenate([draw.uniform(-5000, 5000, (4000, 2)), np.zeros((4000, 2))], axis=-1)) - [0.5, -2.0]
        sizes.append((over**2).sum(axis=-1).mean())
        means.append(over.mean(axis=0))
    assert np.mean(sizes) == pytest.approx(1.5**2, rel=0.03)
    assert np.abs(np.mean(means, axis=0)).max() < 0.05


def test_winds_are_correlated_over_the_length_of_the_field() -> None:
    """Over seeds, E[w(r)·w(r + d)]/rms² is E[cos(k·d)] = exp(−d²/2L²) for k normal with std 1/L an axis."""
    here, near, far = [], [], []
    for seed in range(400):
        wind = MeanWind(load(None, [*FIELD, f"seed={seed}"]))(at((0, 0), (10, 0), (80, 0))) - [0.5, -2.0]
        here.append(wind[0] @ wind[0]), near.append(wind[0] @ wind[1]), far.append(wind[0] @ wind[2])
    assert np.mean(near) / 1.5**2 == pytest.approx(math.exp(-(10**2) / 2 / 20**2), abs=0.1)
    assert np.mean(far) / 1.5**2 == pytest.approx(0.0, abs=0.1)
    assert np.mean(here) == pytest.approx(1.5**2, rel=0.1)


def test_the_field_has_no_divergence() -> None:
    wind, h = MeanWind(load(None, FIELD)), 1e-4
    for x, y in np.random.default_rng(3).uniform(-100, 100, (20, 2)).tolist():
        right, left, up, down = wind(at((x + h, y), (x - h, y), (x, y + h), (x, y - h)))
        assert (right[0] - left[0] + up[1] - down[1]) / (2 * h) == pytest.approx(0.0, abs=1e-6)


def test_power_by_airspeed_is_that_of_the_speed_through_the_air() -> None:
    flown = load(None, [*FIELD, 'vehicle.power_speed="air"'])
    wind, states = MeanWind(flown), np.array([[10.0, 20.0, 3.0, -1.0], [-40.0, 5.0, 0.0, 0.0]])
    through = np.linalg.norm(states[:, 2:] - wind(states), axis=-1)
    found = PointMass(PointMass.Options(), flown).power(states, {}, np.zeros((2, 2)))
    np.testing.assert_allclose(found, power(through), rtol=1e-12)
    over_ground = PointMass(PointMass.Options(), load(None, FIELD)).power(states, {}, np.zeros((2, 2)))
    np.testing.assert_array_equal(over_ground, power(np.linalg.norm(states[:, 2:], axis=-1)))


TRUE = ("truth.drag=0.3", "truth.wind=[3.0, -2.0]")


def test_the_world_flies_the_truth() -> None:
    true, said = Flight(load(None, TRUE)), Flight(load(None, ["wind.drag=0.3", "wind.mean=[3.0, -2.0]"]))
    for flight in (true, said):
        for _ in range(5):
            flight.advance(np.zeros((25, 2)))
    np.testing.assert_array_equal(true.states, said.states)


def test_no_agent_or_leader_is_told_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    import meanflock.worldsim.admission as admission

    sent = []
    monkeypatch.setattr(admission.scenario, "encode", lambda flown: sent.append(encode(flown)) or sent[-1])
    flown = load(None, [*TRUE, "uavs=3"])
    Engine(flown, "truth", uavs_per_node=1)
    assert len(sent) == 4
    for raw in sent:
        assert decode(raw) == resolved(load(None, ["uavs=3"]))
    assert flown.known().truth.wind is None
    assert load(None).known() == load(None)


def test_a_true_drag_that_no_tick_can_follow_is_refused() -> None:
    with pytest.raises(BadInput, match=r"unstable with `truth.drag` 30"):
        load(None, ["truth.drag=30"])
