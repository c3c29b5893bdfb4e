"""Motion and mean wind: exact limits and moments, and who is told of it; vehicles of users; limited acceleration."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.launch.station import StoredTelemetry
from meanflock.swarm import plugins, state
from meanflock.swarm.events import Lost
from meanflock.swarm.scenario import Scenario, decode, encode, load
from meanflock.swarm.seeds import generator
from meanflock.swarm.stateful import restore, state_of
from meanflock.worldsim.books import Noise
from meanflock.worldsim.checkpoint import Resumption, decoded
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.vehicles.base import Hidden, MeanWind
from meanflock.worldsim.vehicles.point_mass import PointMass
from tests.memory_swarm import MemorySwarm
from tests.testing.good import GoodVehicle

ORACLES = Path(__file__).parents[1] / "oracle"
WIND, POWER = (json.loads((ORACLES / f"{name}.json").read_text()) for name in ("wind", "power"))
ROWS = 4000


@pytest.mark.parametrize("case", WIND, ids=lambda case: f"{case['t_s']}s")
def test_mean_and_variance_are_those_of_the_ornstein_uhlenbeck_wind(case: dict[str, Any]) -> None:
    dt = {1.0: 0.01, 10.0: 0.02, 50.0: 0.05}[case["t_s"]]
    end, draw, still = np.zeros((ROWS, 4)), np.random.default_rng(1), np.zeros((ROWS, 2))
    vehicle = PointMass(PointMass.Options(), load(None, [f"dt={dt}", "wind.sigma=0.1", "wind.drag=0.1"]))
    for _ in range(round(case["t_s"] / dt)):
        end, _ = vehicle.step(end, {}, still, draw.standard_normal((ROWS, 2)))
    for part, name in ((state.velocity, "velocity"), (state.position, "position")):
        mean, variance = np.array(case[f"{name}_mean"]), case[f"{name}_variance"]
        error = np.abs(part(end).mean(axis=0) - mean) / math.sqrt(variance / ROWS)
        assert (error < 4).all(), (name, error)
        error = np.abs(part(end).var(axis=0) - variance) / (variance * math.sqrt(2 / ROWS))
        assert (error < 4).all(), (name, error)
    across = np.corrcoef(end[:, 2], end[:, 3])[0, 1]
    assert abs(across) < 4 / math.sqrt(ROWS)


def noise(*settings: str, ticks: int = 4000) -> np.ndarray:
    """The noise of the motion, (T, N, 2)."""
    drawn = Noise(load(None, ["uavs=3", *settings]))
    return np.stack([drawn.next() for _ in range(ticks)])


@pytest.mark.parametrize("common", [0.3, 1.0])
def test_the_noise_of_two_uavs_has_the_common_share_and_that_of_one_its_variance(common: float) -> None:
    drawn = noise(f"wind.common={common}")
    error = 4 / math.sqrt(drawn.size)
    assert drawn.mean() == pytest.approx(0.0, abs=error * math.sqrt(3))
    assert drawn.var() == pytest.approx(1.0, abs=error * math.sqrt(6))
    for first, second in ((0, 1), (0, 2), (1, 2)):
        for axis in (0, 1):
            assert np.corrcoef(drawn[:, first, axis], drawn[:, second, axis])[0, 1] == pytest.approx(
                common, abs=4 / math.sqrt(len(drawn))
            )
    assert abs(np.corrcoef(drawn[:, 0, 0], drawn[:, 1, 1])[0, 1]) < 4 / math.sqrt(len(drawn))


def test_without_a_common_share_the_noise_is_drawn_as_ever() -> None:
    expected = generator(1, "wind").standard_normal((100, 3, 2))
    for settings in ((), ("wind.common=0",)):
        np.testing.assert_array_equal(noise(*settings, ticks=100), expected)


def test_common_noise_goes_on_with_a_resumed_flight() -> None:
    flown = load(None, ["uavs=3", "wind.common=0.4"])
    whole, first, second = Noise(flown), Noise(flown), Noise(flown)
    for _ in range(70):  # in the second block of 50 ticks
        whole.next(), first.next()
    restore(second, state_of(first))
    for _ in range(70):
        np.testing.assert_array_equal(second.next(), whole.next())


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
    near, far = [], []
    for seed in range(400):
        wind = MeanWind(load(None, [*FIELD, f"seed={seed}"]))(at((0, 0), (10, 0), (80, 0))) - [0.5, -2.0]
        near.append(wind[0] @ wind[1]), far.append(wind[0] @ wind[2])
    assert np.mean(near) / 1.5**2 == pytest.approx(math.exp(-(10**2) / 2 / 20**2), abs=0.1)
    assert np.mean(far) / 1.5**2 == pytest.approx(0.0, abs=0.1)


def test_the_field_has_no_divergence() -> None:
    wind, h = MeanWind(load(None, FIELD)), 1e-4
    for x, y in np.random.default_rng(3).uniform(-100, 100, (20, 2)).tolist():
        right, left, up, down = wind(at((x + h, y), (x - h, y), (x, y + h), (x, y - h)))
        assert (right[0] - left[0] + up[1] - down[1]) / (2 * h) == pytest.approx(0.0, abs=1e-6)


def power(speed: np.ndarray) -> np.ndarray:
    """In W, of speeds in m/s."""
    states = np.zeros((len(speed), 4))
    states[:, 2] = speed
    return PointMass(PointMass.Options(), load(None)).power(states, {}, np.zeros((len(speed), 2)))


def test_power_is_the_oracle_s() -> None:
    speeds, expected = np.array([(case["speed_m_s"], case["power_W"]) for case in POWER]).T
    np.testing.assert_allclose(power(speeds), expected, rtol=1e-9)


def test_power_by_airspeed_is_that_of_the_speed_through_the_air() -> None:
    flown = load(None, [*FIELD, 'vehicle.power_speed="air"'])
    wind, states = MeanWind(flown), np.array([[10.0, 20.0, 3.0, -1.0], [-40.0, 5.0, 0.0, 0.0]])
    through = np.linalg.norm(states[:, 2:] - wind(states), axis=-1)
    found = PointMass(PointMass.Options(), flown).power(states, {}, np.zeros((2, 2)))
    np.testing.assert_allclose(found, power(through), rtol=1e-12)
    over_ground = PointMass(PointMass.Options(), load(None, FIELD)).power(states, {}, np.zeros((2, 2)))
    np.testing.assert_array_equal(over_ground, power(np.linalg.norm(states[:, 2:], axis=-1)))


TRUE = ("truth.drag=0.3", "truth.wind=[3.0, -2.0]", "energy.radio_W=0.5")


def test_the_world_flies_the_truth() -> None:
    true, said = Flight(load(None, TRUE)), Flight(load(None, ["wind.drag=0.3", "wind.mean=[3.0, -2.0]"]))
    for flight in (true, said):
        for _ in range(5):
            flight.advance(np.zeros((25, 2)))
    np.testing.assert_array_equal(true.states, said.states)


def test_no_agent_or_leader_is_told_the_truth_or_the_prices(monkeypatch: pytest.MonkeyPatch) -> None:
    import meanflock.net.admission as admission

    sent = []
    monkeypatch.setattr(admission.scenario, "encode", lambda flown: sent.append(encode(flown)) or sent[-1])
    flown = load(None, [*TRUE, "uavs=3"])
    MemorySwarm(flown, "truth", uavs_per_node=1)
    assert len(sent) == 4
    for raw in sent:
        assert decode(raw) == plan_of(load(None, ["uavs=3"])).node_scenario
    assert flown.known().truth.wind is None
    assert load(None).known() == load(None)


class Glider(GoodVehicle):
    """Counts its ticks beside its thrust."""

    name = "glider"

    def init(self, uavs: int) -> Hidden:
        return super().init(uavs) | {"flown": np.zeros((uavs, 2), dtype=np.int32)}

    def step(self, states: Any, hidden: Hidden, acceleration: Any, noise: Any) -> tuple[Any, Hidden]:
        moved, after = super().step(states, hidden, acceleration, noise)
        return moved, after | {"flown": hidden["flown"] + 1}


def gliding(*settings: str, vehicle: type = Glider) -> Scenario:
    plugins.register(vehicle)
    return load(None, ["uavs=4", "vehicle.model=glider", *settings])


def test_the_hidden_state_of_a_vehicle_goes_on_with_a_resumed_flight() -> None:
    flown = gliding("duration=25", 'stop="duration"')
    engine = Engine(flown, "glide", sinks=[kept := StoredTelemetry()])
    whole = engine.complete()
    assert (engine.world.flight.hidden["flown"] == 250).all()
    carrier = next(block for block in kept.blocks if block.checkpoint)
    tick = carrier.first_tick + len(carrier.states) - 1
    states = np.concatenate([block.states for block in kept.blocks])[: tick + 1]
    resumed = Engine(flown, "glide", resume=Resumption(decoded(carrier.checkpoint), states))
    hidden = resumed.world.flight.hidden
    assert hidden["flown"].dtype == np.int32
    assert (hidden["flown"] == tick).all()
    summary = resumed.complete()
    for name in ("trajectory_sha256", "energy_end_mean_J"):
        assert summary[name] == whole[name]


def test_who_leaves_every_bound_is_put_back_with_what_it_hides() -> None:
    flight = Flight(gliding())
    flight.advance(np.zeros((4, 2)))
    before, asked = flight.states.copy(), np.zeros((4, 2))
    asked[2] = 1e15
    flight.advance(asked)
    assert flight.status.tolist() == [0, 0, 2, 0]
    np.testing.assert_array_equal(flight.states[2, :2], before[2, :2])
    assert not flight.states[2, 2:].any()
    assert flight.hidden["flown"][:, 0].tolist() == [2, 2, 1, 2]
    assert np.isfinite(flight.energy).all()


def test_the_world_shortens_a_command_beyond_the_limit_keeps_its_direction_and_counts_it() -> None:
    flight = Flight(load(None, ["uavs=4", "vehicle.acceleration_max=2", "wind.sigma=0", "wind.drag=0"]))
    commands = np.array([[2.0, 0.0], [3.0, -4.0], [0.0, 2.0 + 1e-12], [0.0, 0.0]])
    flight.lose(np.array([3]), Lost, "by the test")
    flight.advance(commands)
    np.testing.assert_allclose(flight.states[:, 2:], 0.1 * np.array([[2.0, 0.0], [1.2, -1.6], [0.0, 2.0], [0.0, 0.0]]))
    assert flight.clipped == 1
    assert flight.effort == pytest.approx([4.0, 4.0, 4.0, 0.0])
