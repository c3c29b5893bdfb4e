"""Columns of a vehicle: in the time series, in recordings and plots; names and numbers that cannot be columns."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.federation.plan import plan_of
from meanflock.recording import plots
from meanflock.results.plots.run import plot_run
from meanflock.results.series import Reported
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.scenario import Scenario
from tests.testing.good import GoodVehicle, having

SPACE: dict[str, Any] = {"uavs": 3, "duration": 4.0, "stop": "duration", "space.dimensions": 3}
CALM = {"vehicle.model": "quadrotor", "wind.sigma": 0.0, "wind.drag": 0.0, "filter.kind": "ecbf"}
SHOWN = ("roll_rad", "pitch_rad", "yaw_rad", "thrust_N")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> mf.Run:
    """A quadrotor under a controller with diagnostics."""
    return mf.fly(method="cruise", out=tmp_path_factory.mktemp("flown"), **SPACE, **CALM)


def columns(run: mf.Run, *names: str) -> np.ndarray:
    return np.stack([np.array(run.frame()[name].to_pylist()) for name in names], axis=-1)


def test_the_time_series_has_the_columns_of_every_tick_behind_the_diagnostics(flown: mf.Run) -> None:
    names = flown.frame().schema.names
    first, *others = plan_of(flown.scenario).declared.diagnostics
    assert tuple(names[names.index(first) : names.index("status")]) == (first, *others, *SHOWN)
    roll, pitch, yaw, thrust = np.moveaxis(columns(flown, *SHOWN), -1, 0)
    assert (roll[0] == 0.0).all()
    assert thrust[0] == pytest.approx(0.5 * 9.81)
    assert roll[1:].any()
    assert pitch[1:].any()
    assert np.abs(yaw).max() < 0.1
    gained = np.diff(flown.states[..., 5], axis=0) / flown.scenario.dt
    lift = thrust * np.cos(roll) * np.cos(pitch) / 0.5 - 9.81  # acceleration upward at the end of each tick
    np.testing.assert_allclose(gained[5:], lift[6:], atol=0.05)
    metadata = flown.frame().schema.field("roll_rad").metadata
    assert metadata[b"unit"] == b"rad"


def test_plots_and_recordings_have_them(flown: mf.Run) -> None:
    assert flown.folder is not None
    reported = Reported.by(plan_of(flown.scenario))
    assert reported == Reported.within(flown.frame())
    assert [plots.diagnostic(name).title for name in SHOWN[:1]] == ["roll, rad: mean, min, max"]
    titles = [axes.get_title(loc="left") for axes in plot_run(Path(flown.folder))["curves"].axes]
    assert sum("thrust" in title for title in titles) == 1


def test_a_vehicle_without_columns_has_none() -> None:
    plan = plan_of(Scenario(method="hjb"))
    assert plan.shown == ()
    assert plan.columns == plan.declared.diagnostics


SHOWS = {"columns": ("tilt_rad",), "shown": lambda _, hidden: hidden["thrust"][:, :1]}


def flight(vehicle: type, method: str = "cruise") -> mf.Run:
    plugins.register(vehicle)
    return mf.fly(method=method, uavs=3, duration=1.0, **{"vehicle.model": "good"})


def test_a_vehicle_of_a_plugin_shows_columns_under_its_names() -> None:
    run = flight(having(GoodVehicle, **SHOWS), "mfg")
    assert columns(run, "tilt_rad").shape == (11, 3, 1)
    about = run.frame().schema.field("tilt_rad").metadata[b"description"].decode()
    assert about.startswith("tilt_rad of controller or vehicle, for each UAV")


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("x_m",), r"vehicle 'good': `columns` x_m: the time series has columns of that name"),
        (("phi_G",), r"`columns` phi_G: controller 'mfg' has diagnostics of that name; give it another"),
        ("tilt_rad", r"`columns` is a text; write \('tilt_rad',\)"),
        (("tilt rad",), "must be at most 100 different names of letters"),
        (("tilt_rad", "tilt_rad"), "must be at most 100 different names of letters"),
    ],
)
def test_names_that_cannot_be_columns_are_refused_before_take_off(names: Any, expected: str) -> None:
    with pytest.raises(BadInput, match=expected):
        flight(having(GoodVehicle, **SHOWS | {"columns": names}), "mfg")


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (lambda _, hidden: hidden["thrust"], r"shown: float64 \(3, 2\), expected float64 \(3, 1\)"),
        (lambda _, hidden: hidden["thrust"][:, :1] * np.nan, r"shown of UAV 0: .* is not finite"),
        (lambda _, hidden: hidden["thrust"][:, :1] + 1e31, r"shown has 1e\+31; expected numbers within"),
        (lambda _, hidden: {}["tilt"], r"`shown` failed: KeyError: 'tilt'"),
    ],
)
def test_numbers_that_cannot_be_shown_are_refused_before_take_off_and_end_a_run(shown: Any, expected: str) -> None:
    def later(self: Any, hidden: Any) -> Any:
        return shown(self, hidden) if hidden["thrust"].any() else hidden["thrust"][:, :1]

    with pytest.raises(BadInput, match=f"vehicle 'good': {expected}"):
        flight(having(GoodVehicle, **SHOWS | {"shown": shown}))
    with pytest.raises(RunFailed, match=f"vehicle 'good': {expected}"):
        flight(having(GoodVehicle, **SHOWS | {"shown": later}))
