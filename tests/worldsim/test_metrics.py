"""Metrics of a flock, and energy: the oracle's cases, and flights measured again by hand."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock import kernels
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import state
from meanflock.swarm.scenario import Energy, Truth, load
from meanflock.worldsim.flight import Pairs, pairs
from tests.worldsim.flights import power

ORACLES = Path(__file__).parents[1] / "oracle"
ORACLE = json.loads((ORACLES / "metrics.json").read_text())
POWER = json.loads((ORACLES / "power.json").read_text())
PARTS = ("radio", "compute", "total")
METRICS = load(None).metrics
RTOL = 1e-9
cases = pytest.mark.parametrize("case", ORACLE, ids=lambda case: f"N{case['N']}")


def at_rest(states: state.States) -> Pairs:
    return pairs(METRICS, states, states, math.inf)


def states_of(case: dict[str, Any]) -> state.States:
    return np.concatenate([case["position"], case["velocity"]], axis=-1)


@cases
def test_alignment_and_risk_are_the_oracle_s(case: dict[str, Any]) -> None:
    n, seen = case["N"], [at_rest(instant) for instant in states_of(case)]
    alignment = np.mean([kernels.alignment(instant) for instant in states_of(case)])
    assert alignment == pytest.approx(case["phi_A_as_printed"], rel=RTOL)
    near = 2 * np.mean([one.near for one in seen])
    assert (near + n) / n**2 == pytest.approx(case["phi_C_as_printed"], rel=RTOL)
    assert near / (n * (n - 1)) == pytest.approx(case["phi_C_distinct_pairs"], rel=RTOL)


def test_power_is_the_oracle_s() -> None:
    speeds = np.array([case["speed_m_s"] for case in POWER], dtype=float)
    expected = [case["power_W"] for case in POWER]
    np.testing.assert_allclose(power(speeds), expected, rtol=1e-9)


def test_radio_and_controllers_have_an_energy_that_changes_no_flight() -> None:
    settings = ["uavs=4", "duration=5", "stop=duration"]
    priced = ["energy.radio_W=0.5", "energy.step_J=0.001"]
    free, paid = (Engine(load(None, [*settings, *more], method="orca"), "x").complete() for more in ([], priced))
    assert paid["trajectory_sha256"] == free["trajectory_sha256"]
    motion = 4 * free["energy_end_mean_J"]
    airtime = free["radio"]["airtime_s"]
    assert airtime > 0
    assert [free[f"energy_{part}_J"] for part in PARTS] == pytest.approx([0.0, 0.0, motion])
    expected = [0.5 * airtime, 0.001 * 4 * 50, motion + 0.5 * airtime + 0.2]
    assert [paid[f"energy_{part}_J"] for part in PARTS] == pytest.approx(expected)


def test_lost_uavs_compute_nothing() -> None:
    kill = "faults=[{kind='kill', time_s=2.0, uavs=[1, 2]}]"
    settings = ["uavs=4", "duration=5", "stop=duration", "energy.step_J=1", kill]
    summary = Engine(load(None, settings, method="cruise"), "x").complete()
    assert summary["lost"] == 2
    assert summary["energy_compute_J"] == 2 * 50 + 2 * 20


def test_no_controller_sees_the_prices() -> None:
    scenario = load(None, ["energy.radio_W=0.5", "truth.drag=0.2"])
    assert scenario.known().energy == Energy()
    assert scenario.known().truth == Truth()
    assert scenario.known().sha256() == load(None).sha256()
