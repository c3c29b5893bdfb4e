"""A run of the grid is a run of the engine that somebody looked at."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.studies.paper import experiments
from meanflock.studies.paper.flown import fly
from meanflock.studies.paper.methods import Method
from meanflock.swarm.scenario import Scenario, load

RTOL = 1e-9
# What the grid kept of the paper's scenario, seed 1, 60 s, while its runs were flown by an engine of their own: scalars
# of `runs.parquet`; of each column of the series how many values are known, their mean and the last; sums of models.
KEPT_BEFORE: dict[str, Any] = json.loads(Path(__file__).with_name("grid_runs.json").read_text(encoding="utf-8"))


def small(method: str, *settings: str, uavs: int = 6, seed: int = 1, duration: float = 15.0) -> Scenario:
    return load(None, ["federation.period=20", *settings], method=method, uavs=uavs, seed=seed, duration=duration)


def steady(summary: dict[str, Any]) -> dict[str, Any]:
    """What does not depend on the machine."""
    return {name: value for name, value in summary.items() if name not in ("wall_time_s", "real_time_factor")}


@pytest.mark.parametrize("method", list(Method))
def test_the_numbers_of_the_grid_are_what_they_were(method: Method) -> None:
    before = KEPT_BEFORE[method]
    flown = fly(load(None, ["stop=duration"], method=method, seed=1, duration=60.0))
    scalars = experiments.scalars(flown)
    for name, value in before["scalars"].items():
        assert scalars[name] == (value if value is None else pytest.approx(value, rel=RTOL)), name
    for name, (count, *mean_and_last) in before["series"].items():
        values = flown.record.series[name]
        known = values[np.isfinite(values)]
        assert len(known) == count
        assert not count or [known.mean(), known[-1]] == pytest.approx(mean_and_last, rel=RTOL), name
    assert [np.abs(flown.models).sum(), flown.models[-1].sum()] == pytest.approx(before["models"], rel=RTOL)


@pytest.mark.parametrize("method", list(Method))
def test_looking_changes_nothing(method: Method) -> None:
    scenario = small(method, "radio.target_snr_db=78")
    alone = Engine(scenario, f"{method}-s1").complete()
    assert steady(fly(scenario, traced=True).summary) == steady(alone)


@pytest.mark.parametrize("method", ["hjb", "mfgfl-hf"])
def test_a_run_whose_learners_diverged_says_so(method: str) -> None:
    flown = fly(small(method, "learner.position_scale=40", "learner.velocity_scale=4", "stop=duration", duration=30.0))
    assert flown.summary["lost"] > 0
    assert flown.record.scalars["diverged"] is True
    assert flown.record.series["lost"][-1] == flown.summary["lost"]
    assert np.isfinite(flown.record.series["value_norm_max"]).all()


def test_a_swarm_of_one_knows_nothing_of_pairs() -> None:
    series = fly(small("mfgfl-hf", uavs=1)).record.series
    assert np.isnan(series["phi_C_distinct"]).all()
    assert np.isnan(series["pair_distance_m"]).all()
    assert np.isfinite(series["phi_C"]).all()


def test_weights_can_be_carried_over() -> None:
    scenario = small("mfgfl-hf", uavs=3)
    first = fly(scenario)
    again = fly(scenario, models=first.models)
    nothing = fly(scenario, models=np.zeros_like(first.models))
    assert len({flown.summary["trajectory_sha256"] for flown in (first, again, nothing)}) == 3


def test_series_is_what_the_run_says_of_itself() -> None:
    flown = fly(small("mfgfl-hf", "stop=duration", seed=3, duration=12.0), traced=True)
    series, summary = flown.record.series, flown.summary
    np.testing.assert_allclose(series["t_s"], np.arange(13.0))
    for name in ("phi_A", "phi_C", "phi_C_distinct", "collisions", "arrived", "distance_mean_m"):
        assert series[name][-1] == pytest.approx(summary[name], rel=1e-12), name
    assert series["bits"][0] == 6 * 4 * 32  # the mission plan
    assert series["bits"][-1] == summary["payload_bits"]["total"]
    assert series["energy_mean_J"][-1] == pytest.approx(summary["energy_end_mean_J"])
    assert series["energy_trip_mean_J"][-1] == pytest.approx(summary["energy_mean_J"])
    assert series["phi_A"][0] == series["speed_difference_m_s"][0] == 0.0
    assert np.isnan(series["hjb_abs_mean"][0])
    assert (series["hjb_abs_max"][1:] <= summary["hjb_residual_max"]).all()
    assert (series["speed_min_m_s"] <= series["speed_mean_m_s"]).all()
    scalars = flown.record.scalars
    assert scalars["phi_A_175"] is None  # the flight was shorter
    assert scalars["phi_A_mission"] == pytest.approx(summary["phi_A"])
    assert scalars["bits_mission"] == summary["payload_bits"]["total"]
    trace = flown.record.trace
    assert trace is not None
    assert trace.states.shape == (61, 6, 4)
    assert trace.weights.shape == (13, 246)
    np.testing.assert_allclose(trace.weights[-1], flown.models[0], rtol=1e-6)


def test_figures_at_an_instant_are_those_of_a_flight_that_ends_there() -> None:
    whole, ends = (fly(small("mfgfl-h", "stop=duration", duration=duration)) for duration in (180.0, 175.0))
    for name in ("phi_A", "phi_C", "phi_C_distinct", "collisions"):
        assert whole.record.scalars[f"{name}_175"] == pytest.approx(ends.summary[name], rel=1e-12)
    assert whole.record.scalars["bits_175"] == ends.summary["payload_bits"]["total"]


def test_mission_figures_are_those_of_a_flight_that_stops_on_arrival() -> None:
    near = ["start.centre=[30.0, 20.0]", "learner.kappa=0.1"]
    on, stops = (
        fly(small("mfgfl-h", *near, f"stop={stop}", uavs=3, duration=60.0)) for stop in ("duration", "arrival")
    )
    assert on.record.scalars["all_arrived"]
    for name in ("phi_A", "phi_C", "phi_C_distinct", "collisions"):
        assert on.record.scalars[f"{name}_mission"] == pytest.approx(stops.summary[name], rel=1e-12)
    assert on.record.scalars["bits_mission"] == stops.summary["payload_bits"]["total"]
    assert on.record.scalars["t_avg_censored_s"] == pytest.approx(on.summary["t_avg_s"])
