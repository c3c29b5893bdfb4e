"""A batch flies the runs the engine would fly, to the last bit."""

import json
from typing import Any

import numpy as np
import pytest

from groundstation.engine import Engine
from groundstation.paper.batch import Batch, Flown
from groundstation.paper.series import SERIES
from swarm.errors import BadInput
from swarm.methods import Method
from swarm.scenario import Scenario, load

SEEDS = (1, 2, 5)


def small(method: str, *settings: str, uavs: int = 6, duration: float = 15.0) -> Scenario:
    return load(None, ["federation.period=20", *settings], method=method, uavs=uavs, duration=duration)


def alone(scenario: Scenario) -> dict[str, Any]:
    engine = Engine(scenario, "test")
    for _ in engine.fly():
        pass
    return engine.world.finish()


def comparable(summary: dict[str, Any]) -> dict[str, Any]:
    """All of a summary but its name, its clock and the bytes nobody encoded."""
    copy = json.loads(json.dumps(summary))
    for name in ("run_id", "mode", "wall_time_s", "real_time_factor", "wire_bytes"):
        del copy[name]
    for traffic in copy["radio"]["traffic"].values():
        del traffic["wire_bytes"]
    return copy


def assert_same(flown: list[Flown]) -> None:
    for one in flown:
        assert comparable(one.summary) == comparable(alone(one.scenario)), one.scenario.seed


@pytest.mark.parametrize("method", list(Method))
def test_every_run_of_a_batch_is_the_engines_run(method: Method) -> None:
    assert_same(Batch(small(method), SEEDS).fly())


@pytest.mark.parametrize(
    ("method", "settings"),
    [
        ("mfgfl-hf", ["radio.target_snr_db=78"]),  # many outages
        ("mfgfl-hf", ["radio.coherence_time_s=0.05"]),  # uploads take several ticks
        ("mfgfl-hf", ["radio.bits_per_float=16", "cost.beta=0.7", "cost.epsilon=0.3"]),
        ("mfgfl-hf", ["federation.payload=int8", "federation.broadcast_payload=int8", "radio.target_snr_db=78"]),
        ("mfgfl-hf", ["federation.clusters=3", "federation.leader=4", "radio.target_snr_db=77"]),
        ("mfgfl-h", ["federation.clusters=2", "radio.coherence_time_s=0.03", "federation.payload=int8"]),
        ("mfgfl-f", ["federation.payload=float16", "federation.fraction=0.5"]),
        ("mfgfl-h", ["federation.payload=int8", "federation.error_feedback=false"]),
        ("mfgfl-h", ["wind.sigma=1.5", "federation.fraction=0.3", "federation.leader=3"]),
        ("mfgfl-f", ["federation.state_period=30", "density.near_samples=50", "density.box_samples=50"]),
        ("mfg", ["federation.state_period=25", "density.near_samples=50", "density.box_samples=50"]),
        ("hjb", ["radio.range_m=3", "radio.target_snr_db=78"]),  # not everyone is in range
        ("hjb", ["radio.path_loss_exponent=0.1", "radio.fading=power"]),  # links differ
        ("hjb", ["radio.coherence_time_s=0.05"]),  # states arrive ticks later: the plain radio
        ("hjb", ["radio.bits_per_float=64", "radio.target_snr_db=50"]),  # two good slots a message
    ],
)
def test_bits_hold_away_from_the_defaults(method: str, settings: list[str]) -> None:
    assert_same(Batch(small(method, *settings, duration=10.0), SEEDS).fly())


@pytest.mark.parametrize("method", ["hjb", "mfgfl-hf"])
def test_diverged_learners_are_silenced_and_counted_alike(method: str) -> None:
    flown = Batch(small(method, "learner.position_scale=40", "learner.velocity_scale=4", duration=30.0), SEEDS).fly()
    assert any(one.summary["lost"] for one in flown)
    assert all(one.record.scalars["diverged"] == (one.summary["lost"] > 0) for one in flown)
    assert_same(flown)


@pytest.mark.parametrize("method", ["offline", "hjb", "mfgfl-hf"])
def test_finished_runs_leave_and_the_others_fly_on(method: str) -> None:
    near = ["start.centre=[30.0, 20.0]", "learner.kappa=0.1", "federation.payload=int8"]
    flown = Batch(small(method, *near, uavs=3, duration=60.0), SEEDS).fly()
    assert len({one.summary["ticks"] for one in flown}) > 1
    assert [one.scenario.seed for one in flown] == list(SEEDS)
    assert_same(flown)


def test_a_batch_of_one_uav_and_of_one_run() -> None:
    assert_same(Batch(small("mfgfl-hf", uavs=1), (4,)).fly())
    assert_same(Batch(small("hjb", uavs=2), (4,)).fly())


@pytest.mark.parametrize("setting", ["federation.byzantine_fraction=0.2", "faults=[{kind='kill', tick=3, uavs=[1]}]"])
def test_what_only_nodes_can_play_is_refused(setting: str) -> None:
    with pytest.raises(BadInput, match="without"):
        Batch(small("mfgfl-hf", setting), SEEDS)


def test_weights_can_be_carried_over() -> None:
    scenario = small("mfgfl-hf", uavs=3)
    first = Batch(scenario, (1, 2)).fly()
    again = Batch(scenario, (1, 2), weights=[one.weights for one in first]).fly()
    fresh = Batch(scenario, (1, 2), weights=[np.zeros_like(one.weights) for one in first]).fly()
    for trained, one, untrained in zip(again, first, fresh, strict=True):
        shas = {run.summary["trajectory_sha256"] for run in (trained, one, untrained)}
        assert len(shas) == 3


def test_series_is_what_the_run_says_of_itself() -> None:
    scenario = small("mfgfl-hf", "stop=duration", duration=12.0)
    (flown,) = Batch(scenario, (3,), trace=(3,)).fly()
    series, summary = flown.record.series, flown.summary
    assert tuple(series) == SERIES
    np.testing.assert_allclose(series["t_s"], np.arange(13.0))
    for name in ("phi_A", "phi_C", "phi_C_distinct", "collisions", "arrived", "distance_mean_m"):
        assert series[name][-1] == pytest.approx(summary[name], rel=1e-12), name
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
    np.testing.assert_allclose(trace.weights[-1], flown.weights[0], rtol=1e-6)


def test_figures_at_an_instant_are_those_of_a_flight_that_ends_there() -> None:
    whole = Batch(small("mfgfl-h", "stop=duration", duration=180.0), (1,)).fly()[0]
    ends = Batch(small("mfgfl-h", "stop=duration", duration=175.0), (1,)).fly()[0]
    for name in ("phi_A", "phi_C", "phi_C_distinct", "collisions"):
        assert whole.record.scalars[f"{name}_175"] == pytest.approx(ends.summary[name], rel=1e-12)
    assert whole.record.scalars["bits_175"] == ends.summary["payload_bits"]["total"]


def test_mission_figures_are_those_of_a_flight_that_stops_on_arrival() -> None:
    near = ["start.centre=[30.0, 20.0]", "learner.kappa=0.1"]
    on, stops = (
        Batch(small("mfgfl-h", *near, f"stop={stop}", uavs=3, duration=60.0), (1,)).fly()[0]
        for stop in ("duration", "arrival")
    )
    assert on.record.scalars["all_arrived"]
    for name in ("phi_A", "phi_C", "phi_C_distinct", "collisions"):
        assert on.record.scalars[f"{name}_mission"] == pytest.approx(stops.summary[name], rel=1e-12)
    assert on.record.scalars["bits_mission"] == stops.summary["payload_bits"]["total"]
    assert on.record.scalars["t_avg_censored_s"] == pytest.approx(on.summary["t_avg_s"])
