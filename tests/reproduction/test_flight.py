"""A flight of the grid: the engine's flight with a record beside it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.scenario import Scenario, load
from reproduction import experiments
from reproduction.flight import fly
from reproduction.grid import Method

RTOL = 1e-9
# The record of the paper's scenario, seed 1, 60 s, from an independent recorder: scalars of `runs.parquet`; of each
# series column the number of finite values, their mean and the last; sums of the models.
RECORDED: dict[str, Any] = json.loads(Path(__file__).with_name("grid_runs.json").read_text(encoding="utf-8"))


def small(method: str, *settings: str, uavs: int = 6, seed: int = 1, duration: float = 15.0) -> Scenario:
    return load(None, ["federation.period=20", *settings], method=method, uavs=uavs, seed=seed, duration=duration)


@pytest.mark.parametrize("method", list(Method))
def test_the_record_has_the_known_numbers(method: Method) -> None:
    expected = RECORDED[method]
    flown = fly(load(None, ["stop=duration"], method=method, seed=1, duration=60.0))
    scalars = experiments.scalars(flown)
    for name, value in expected["scalars"].items():
        assert scalars[name] == (value if value is None else pytest.approx(value, rel=RTOL)), name
    for name, (count, *mean_and_last) in expected["series"].items():
        values = flown.record.series[name]
        finite = values[np.isfinite(values)]
        assert len(finite) == count
        assert not count or [finite.mean(), finite[-1]] == pytest.approx(mean_and_last, rel=RTOL), name
    assert [np.abs(flown.models).sum(), flown.models[-1].sum()] == pytest.approx(expected["models"], rel=RTOL)


def test_a_flight_whose_learners_diverge_is_marked() -> None:
    settings = ("learner.position_scale=40", "learner.velocity_scale=4", "stop=duration")
    flown = fly(small("mfgfl-hf", *settings, duration=30.0))
    assert flown.summary["lost"] > 0
    assert flown.record.scalars["diverged"] is True
    assert flown.record.series["lost"][-1] == flown.summary["lost"]
    assert np.isfinite(flown.record.series["value_norm_max"]).all()
    alone = fly(small("mfgfl-hf", uavs=1)).record.series  # a swarm without pairs
    assert np.isnan([alone["phi_C_distinct"], alone["pair_distance_m"]]).all()


def test_the_series_ends_with_the_numbers_of_the_summary() -> None:
    scenario = small("mfgfl-hf", "stop=duration", seed=3, duration=12.0)
    flown = fly(scenario, traced=True)
    series, summary = flown.record.series, flown.summary
    assert summary["trajectory_sha256"] == Engine(scenario, "alone").complete()["trajectory_sha256"]
    np.testing.assert_allclose(series["t_s"], np.arange(13.0))
    for name in ("phi_A", "phi_C", "phi_C_distinct", "collisions", "arrived", "distance_mean_m"):
        assert series[name][-1] == pytest.approx(summary[name], rel=1e-12), name
    assert series["bits"][0] == 6 * 4 * 32  # the mission plan
    assert series["bits"][-1] == summary["payload_bits"]["total"]
    assert series["energy_mean_J"][-1] == pytest.approx(summary["energy_end_mean_J"])
    assert series["energy_trip_mean_J"][-1] == pytest.approx(summary["energy_mean_J"])
    assert np.isnan(series["hjb_abs_mean"][0])
    assert flown.record.scalars["phi_A_175"] is None  # the flight was shorter
    trace = flown.record.trace
    assert trace is not None
    assert trace.states.shape == (61, 6, 4)
    np.testing.assert_allclose(trace.weights[-1], flown.models[0], rtol=1e-6)


NEAR = ("start.centre=[30.0, 20.0]", "learner.kappa=0.1")  # all arrive within a minute


@pytest.mark.parametrize(
    ("instant", "longer", "shorter"),
    [
        ("175", small("mfgfl-h", "stop=duration", duration=180.0), small("mfgfl-h", "stop=duration", duration=175.0)),
        (
            "mission",
            small("mfgfl-h", *NEAR, "stop=duration", uavs=3, duration=60.0),
            small("mfgfl-h", *NEAR, "stop=arrival", uavs=3, duration=60.0),
        ),
    ],
)
def test_numbers_at_an_instant_are_those_of_a_flight_that_ends_there(
    instant: str, longer: Scenario, shorter: Scenario
) -> None:
    scalars, summary = fly(longer).record.scalars, fly(shorter).summary
    assert scalars["all_arrived"] or instant == "175"
    for name in ("phi_A", "phi_C", "phi_C_distinct", "collisions"):
        assert scalars[f"{name}_{instant}"] == pytest.approx(summary[name], rel=1e-12), name
    assert scalars[f"bits_{instant}"] == summary["payload_bits"]["total"]
