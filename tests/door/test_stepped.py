"""`mf.Stepped`: the caller commands each tick, and the flight is that of `mf.fly`."""

import json
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import meanflock as mf
from meanflock.swarm.plugins import load, load_file
from tests.testing.good import GoodVehicle, calls

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL: dict[str, Any] = {"uavs": 4, "seed": 3, "duration": 6.0}
FAULTS: list[dict[str, Any]] = [
    {"kind": "pause", "time_s": 1.0, "duration_s": 1.5, "uavs": [1]},
    {"kind": "kill", "time_s": 3.0, "uavs": [2]},
]


class Caller:
    """A controller that its caller calls: what it does for one stepped flight, tick after tick."""

    def __init__(self, method: str, keys: dict[str, Any]) -> None:
        load_file(EXAMPLES / f"{method}.py")
        plugin: Any = load("controller", method)
        self.scenario = mf.Scenario.load("paper", method=method, **SMALL, **keys)
        self.controller = plugin(plugin.Options(), self.scenario)
        self.flight = mf.Stepped(
            "paper", parameters=plugin.parameters, broadcast_numbers=plugin.broadcast_numbers, **SMALL, **keys
        )
        self.rows = np.arange(self.scenario.uavs)
        self.memory = self.controller.init(self.rows, mf.mission.starts(self.scenario))

    def step(self) -> None:
        flight = self.flight
        memory = self.controller.set(self.memory, self.rows, flight.models) if self.controller.parameters else {}
        step = self.controller.step(memory or self.memory, flight.tick, flight.states, flight.received)
        self.memory = step.memory
        models = self.controller.get(self.memory) if self.controller.parameters else None
        flight.step(step.acceleration, step.broadcasts, models)


CASES = [
    ("spring", {}),
    ("spring", {"faults": FAULTS}),
    ("spring", {"filter.kind": "ecbf"}),
    ("trim", {"federation.period": 20}),
]


def test_the_caller_of_interleaved_flights_flies_what_the_controller_flies() -> None:
    callers = [Caller(method, keys) for method, keys in CASES]
    flying = list(callers)
    while flying:
        for caller in flying:
            caller.step()
        flying = [caller for caller in flying if not caller.flight.over]
    for caller in callers:
        expected = mf.fly(caller.scenario)
        run = caller.flight.finish()
        assert run.summary["trajectory_sha256"] == expected.summary["trajectory_sha256"]
        equal = ("payload_bits", "models_sha256", "rounds", "lost", "collisions", "energy_J_by_uav")
        assert {key: run.summary.get(key) for key in equal} == {key: expected.summary.get(key) for key in equal}
        assert run.summary["method"] == "stepped"
        np.testing.assert_array_equal(run.states, expected.states)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((np.zeros((3, 2)),), r"acceleration has shape \(3, 2\); expected \(4, 2\)"),
        ((np.zeros((4, 2), dtype=complex),), r"acceleration is complex128 \(4, 2\); expected real numbers \(4, 2\)"),
        ((np.full((4, 2), "a"),), r"acceleration is <U1 \(4, 2\); expected real numbers"),
        ((None,), r"acceleration is a NoneType; expected real numbers"),
        ((np.zeros((4, 2)), mf.Broadcast(np.zeros((4, 2)))), "`broadcasts` must be a tuple or list of mf.Broadcast"),
        ((np.zeros((4, 2)), [np.zeros((4, 2))]), "mf.Broadcast"),
        ((np.zeros((4, 2)), [mf.Broadcast(np.zeros((4, 9)))]), "9 numbers broadcast"),
        ((np.zeros((4, 2)), (), np.zeros((4, 3))), "models has shape"),
        ((np.zeros((4, 2)), (), np.full((4, 2), np.nan)), "models is not finite"),
    ],
)
def test_a_command_that_does_not_fit_flies_nothing_and_loses_nobody(arguments: Any, says: str) -> None:
    flight = mf.Stepped(parameters=2, broadcast_numbers=8, **SMALL)
    with pytest.raises(mf.BadInput, match=says):
        flight.step(*arguments)
    assert flight.tick == 0
    for _ in range(3):
        flight.step(np.ones((4, 2), dtype=np.float32))
    assert (flight.tick, flight.finish().summary["lost"]) == (3, 0)


def test_a_number_that_is_not_finite_loses_that_uav_only() -> None:
    flight = mf.Stepped(**SMALL)
    command = np.zeros((4, 2))
    command[2, 1] = np.nan
    while not flight.over:
        flight.step(command)
    run = flight.finish()
    lost = [event["uavs"] for event in run.events if event["kind"] == "diverged"]
    assert (run.summary["lost"], lost) == (1, [[2]])
    assert run.states.shape == (61, 4, 4)
    assert flight.finish() is run
    with pytest.raises(mf.BadInput, match="the flight is over"):
        flight.step(command)


def test_a_method_that_is_given_is_ignored_with_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mf.Stepped("paper", **SMALL)
    with pytest.warns(UserWarning, match="method 'lqr' is ignored"):
        mf.Stepped("paper", method="lqr", **SMALL)
    with pytest.warns(UserWarning, match="method 'cruise' is ignored"):
        mf.Stepped(mf.Scenario(method="cruise", controller={"speed_m_s": 1.0}), **SMALL)


def test_a_flight_that_fails_or_is_closed_leaves_a_folder_with_its_ticks(tmp_path: Path) -> None:
    class Stopping(GoodVehicle):
        name = "stopping"

        def step(self, *given: Any) -> Any:
            if calls(self) == 24:
                raise ValueError("it stops")
            return super().step(*given)

    for vehicle, last in ((GoodVehicle, "nodes-joined"), (Stopping, "flight-failed")):
        out = tmp_path / vehicle.name
        with suppress(mf.RunFailed), mf.Stepped(**SMALL, out=out, **{"vehicle.model": vehicle}) as flight:
            for _ in range(30):
                flight.step(np.zeros((4, 2)))
        (folder,) = out.iterdir()
        events = [json.loads(line)["event"] for line in (folder / "events.jsonl").read_text().splitlines()]
        assert events[-1] == last
        assert pq.read_metadata(folder / "timeseries.parquet").num_rows == flight.tick + 1


def test_a_flight_ended_early_is_a_run_with_a_folder(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    with mf.Stepped(uavs=2, out=tmp_path, progress=lambda *ticks: seen.append(ticks)) as flight:
        for _ in range(110):
            flight.step(np.zeros((2, 2)))
        run = flight.finish()
    assert seen == [(100, 3000)]
    np.testing.assert_array_equal(mf.open(run.folder).states, run.states)
    assert len(run.states) == 111


@pytest.mark.parametrize("has_folder", [False, True])
def test_a_closed_flight_cannot_be_finished(has_folder: bool, tmp_path: Path) -> None:
    with mf.Stepped(uavs=2, out=tmp_path if has_folder else None) as flight:
        flight.step(np.zeros((2, 2)))
    with pytest.raises(mf.BadInput, match="`close` has abandoned the flight"):
        flight.finish()
