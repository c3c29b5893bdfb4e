"""Mapping the wind in flight: measurements, ways of sharing them, and the energy they save."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.base import Received
from meanflock.federation.rules.base import Uploads
from meanflock.settings import scenario_of
from meanflock.swarm import mission, plugins
from meanflock.swarm.scenario import Scenario
from meanflock.testing import check_controller
from meanflock.worldsim.vehicles.base import MeanWind
from meanflock.worldsim.vehicles.point_mass import PointMass


def made(share: str, **settings: Any) -> Any:
    return plugins.create("controller", "windmap", {"share": share}, scenario_of("windmap", settings))


def flown(controller: Any, scenario: Scenario, ticks: int, noise: float = 0.0) -> tuple[dict[str, Any], np.ndarray]:
    """Memory and states after some ticks of the first wave, nobody receiving anything."""
    draw, vehicle = np.random.default_rng(0), PointMass(PointMass.Options(), scenario)
    states = mission.starts(scenario)[:5]
    memory = controller.init(np.arange(5), mission.starts(scenario))
    for tick in range(ticks):
        step = controller.step(memory, tick, states, ())
        memory = step.memory
        states, _ = vehicle.step(states, {}, step.acceleration, noise * draw.standard_normal((5, 2)))
    return memory, states


def test_a_map_of_too_many_nodes_is_refused_before_take_off() -> None:
    with pytest.raises(mf.BadInput, match=r"a map of \d+ × \d+ nodes; at most 1000"):
        mf.fly("windmap", method="windmap", **{"controller.spacing_m": 1.5})


@pytest.mark.parametrize("share", ["none", "weights", "precision", "measurements"])
def test_every_way_of_sharing_conforms(share: str) -> None:
    check_controller(plugins.load("controller", "windmap"), {"share": share})


def test_without_noise_the_wind_is_measured_as_it_is() -> None:
    scenario = scenario_of("windmap", {"wind.sigma": 0.0})
    controller = plugins.create("controller", "windmap", {"spacing_m": 5.0}, scenario)
    memory, states = flown(controller, scenario, 102)
    felt = controller.step(memory, 102, states, ()).diagnostics[:, :2]
    assert felt == pytest.approx(MeanWind(scenario)(states), abs=0.1)


def test_a_measurement_counts_by_its_noise() -> None:
    scenario = scenario_of("windmap", {})
    memory, _ = flown(made("none"), scenario, 100, noise=1.0)
    ticks = memory["information"][..., 2].sum(axis=1)
    deviation = 0.1 / np.sqrt(0.1) / 0.1  # σ √dt of velocity in a tick, over dt c0
    assert ticks == pytest.approx(99 / deviation**2)


def test_measurements_of_others_count_as_own_and_absurd_ones_do_not() -> None:
    controller = made("measurements")
    memory = controller.init(np.arange(3), mission.starts(controller.scenario))
    own = mission.starts(controller.scenario)[:3]
    payload = np.array([[100.0, 60.0, 1.0, -1.0], [100.0, 60.0, 1e6, 0.0]])
    received = (Received(0, np.array([7, 9]), payload, np.array([[0, 1], [1, 1], [1, 2]])),)
    step = controller.step(memory, 1, own, received)
    told = step.memory["information"]
    deviation = 0.1 / np.sqrt(0.1) / 0.1
    assert told[1].sum(axis=0) == pytest.approx(np.array([1.0, -1.0, 1.0]) * 20 / deviation**2)
    assert (told[[0, 2]] == 0).all()
    assert step.refused.tolist() == [9]


def test_a_round_of_precisions_gives_every_uav_the_information_of_all() -> None:
    controller = made("precision")
    rows, nodes = np.arange(25), controller._grid.count
    memory = controller.init(rows, mission.starts(controller.scenario))
    information = np.abs(np.random.default_rng(0).standard_normal((25, nodes, 3)))
    information[5:] = 0.0  # on the ground yet
    information[:3, : nodes // 2] = 0.0
    uploads = Uploads.complete(controller.get(memory | {"information": information}), 1, rows)
    rule = plugins.create("aggregator", "precision", {}, controller.scenario)
    _, model = rule.step(rule.init(controller.parameters), uploads)
    memory = controller.set(memory | {"information": information}, rows, np.tile(model, (25, 1)))
    assert controller._information(memory)[17] == pytest.approx(information.sum(axis=0))
    _, model = rule.step({}, Uploads.complete(controller.get(memory), 2, rows))
    again = controller.set(memory, rows, np.tile(model, (25, 1)))
    assert controller._information(again) == pytest.approx(controller._information(memory))  # nothing counts twice


def test_shared_measurements_save_energy() -> None:
    costs = {}
    for name, method, options in (
        ("straight", "straight", {}),
        ("shared", "windmap", {"controller.share": "measurements"}),
    ):
        summary = mf.fly("windmap", method=method, seed=3, **options).summary
        assert summary["arrived"] == 25
        costs[name] = summary["energy_mean_J"] + 0.05 * summary["t_avg_s"]
    assert costs["shared"] < 0.9 * costs["straight"]
