"""The vehicle `trace`: places of a file, exact at its rows and straight between them, and what of a flight follows."""

import re
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as some
from pyarrow import csv, parquet

import meanflock as mf
from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.launch.resume import back
from meanflock.swarm import mission, state
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.testing import check_vehicle
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.vehicles import tracks
from meanflock.worldsim.vehicles.base import ignored
from meanflock.worldsim.vehicles.trace import RecordedTrace
from meanflock.worldsim.vehicles.tracks import TraceRows, Tracks
from tests.faults.dying import dead, flight, resumed

DT = 0.5


def written(path: Path, rows: list[tuple[float, ...]], names: str = "t_s uav x_m y_m") -> Path:
    """A file with some rows."""
    columns = {name: list(values) for name, values in zip(names.split(), zip(*rows, strict=True), strict=True)}
    (csv.write_csv if path.suffix == ".csv" else parquet.write_table)(pa.table(columns), path)
    return path


def winding(axes: int, uavs: int = 5, times: int = 40) -> list[tuple[float, ...]]:
    """Rows of UAVs that wander, time by time."""
    places = 40.0 + np.random.default_rng(4).normal(0.0, 2.0, (times, uavs, axes)).cumsum(axis=0)
    return [(1.0 * time, uav, *places[time, uav].tolist()) for time in range(times) for uav in range(uavs)]


def scenario_of(path: Path, **keys: Any) -> Scenario:
    chosen = {"vehicle.model": "trace", "vehicle.options.file": str(path), "uavs": 5, "dt": DT, "method": "cruise"}
    return Scenario(**chosen | keys)


NAMES = {2: "t_s uav x_m y_m", 3: "t_s uav x_m y_m z_m"}


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_uavs_are_where_the_file_says_and_commands_and_gusts_have_no_effect(
    axes: int, suffix: str, tmp_path: Path
) -> None:
    rows = winding(axes)
    path = written(tmp_path / f"way{suffix}", rows, NAMES[axes])
    flown = plan_of(scenario_of(path, **{"space.dimensions": axes})).scenario
    flight = Flight(flown)
    places = np.array([row[2:] for row in rows]).reshape(-1, 5, axes)
    draw = np.random.default_rng(1)
    for tick in range(1, 100):
        before = state.position(flight.states)
        flight.advance(draw.normal(size=(5, axes)), draw.normal(size=(5, axes)))
        now = state.position(flight.states)
        if tick % 2 == 0:
            np.testing.assert_array_equal(now, places[min(tick // 2, 39)])
        elif tick < 78:
            np.testing.assert_allclose(now, places[tick // 2 : tick // 2 + 2].mean(axis=0), rtol=1e-12)
        np.testing.assert_array_equal(state.velocity(flight.states), (now - before) / DT)


@pytest.mark.parametrize("axes", [2, 3])
def test_it_conforms(axes: int, tmp_path: Path) -> None:
    path = written(tmp_path / "way.parquet", winding(axes), NAMES[axes])
    check_vehicle(RecordedTrace, {"file": str(path)}, Scenario(uavs=5, **{"space.dimensions": axes}))


@given(some.data())
def test_places_are_exact_at_rows_and_depend_on_one_uav_alone(data: some.DataObject) -> None:
    numbers = some.floats(-1e6, 1e6)
    uavs = data.draw(some.integers(1, 4))
    times, whose, places = [], [], []
    for uav in range(uavs):
        own = sorted(data.draw(some.lists(some.integers(-50, 50), min_size=1, max_size=6, unique=True)))
        times += [0.25 * time for time in own]
        whose += [uav] * len(own)
        places += [data.draw(some.tuples(numbers, numbers)) for _ in own]
    mixed = np.argsort(np.array(times), kind="stable")  # of all UAVs, time by time
    rows = TraceRows(np.array(times)[mixed], np.array(whose)[mixed], np.array(places)[mixed])
    tracks = Tracks(rows, 0.0)
    np.testing.assert_array_equal(tracks.at(rows.uavs, rows.times), rows.places)
    asked = np.array([data.draw(some.floats(-20.0, 20.0)) for _ in range(uavs)])
    together = tracks.at(np.arange(uavs), asked)
    for uav in range(uavs):
        own = rows.uavs == uav
        only = TraceRows(rows.times[own], np.zeros(int(own.sum()), dtype=np.int64), rows.places[own])
        np.testing.assert_array_equal(Tracks(only, 0.0).at(np.zeros(1, dtype=np.int64), asked[[uav]])[0], together[uav])
        for axis in range(2):
            expected = np.interp(asked[uav], only.times, only.places[:, axis])
            assert together[uav, axis] == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_uavs_wait_before_their_first_row_and_stay_after_their_last(tmp_path: Path) -> None:
    path = written(tmp_path / "way.csv", [(10, 0, 0.0, 0.0), (11, 0, 4.0, 0.0), (12, 1, 9.0, 9.0), (13, 1, 9.0, 7.0)])
    flight = Flight(plan_of(scenario_of(path, uavs=2)).scenario)
    seen = [flight.states]
    for _ in range(8):
        flight.advance(np.zeros((2, 2)))
        seen.append(flight.states)
    first, second = np.stack(seen, axis=1)
    assert first[:4].tolist() == [[0, 0, 0, 0], [2, 0, 4, 0], [4, 0, 4, 0], [4, 0, 0, 0]]
    assert second[4:].tolist() == [[9, 9, 0, 0], [9, 8, 0, -2], [9, 7, 0, -2], [9, 7, 0, 0], [9, 7, 0, 0]]
    later = plan_of(scenario_of(path, uavs=2, **{"vehicle.options.begin_s": 10.5})).scenario
    assert later.start.positions == ((2.0, 0.0), (9.0, 9.0))


def test_the_hash_of_a_scenario_is_that_of_the_rows_and_not_of_the_path(tmp_path: Path) -> None:
    rows = winding(2)
    one, same = (written(tmp_path / name, rows) for name in ("one.parquet", "same.parquet"))
    other = written(tmp_path / "other.parquet", rows[:-1])
    hashes = [scenario_of(path).sha256() for path in (one, same, other)]
    assert hashes[0] == hashes[1] != hashes[2]
    planned = plan_of(scenario_of(one)).scenario
    one.unlink()
    assert planned.replace().sha256() == hashes[0]  # agents and readers of the run need no file
    assert mission.starts(plan_of(planned.replace()).node_scenario)[:, :2].tolist() == [
        list(row[2:]) for row in rows[:5]
    ]


@pytest.mark.parametrize("axes", [2, 3])
def test_flights_in_one_node_and_in_many_are_equal(axes: int, tmp_path: Path) -> None:
    path = written(tmp_path / "way.parquet", winding(axes), NAMES[axes])
    flown = scenario_of(path, method="vasarhelyi", duration=10.0, **{"space.dimensions": axes})
    one, many = (Engine(flown, "trace", uavs_per_node=rows).complete() for rows in (None, 1))
    assert one["trajectory_sha256"] == many["trajectory_sha256"]
    assert one["payload_bits"] == many["payload_bits"]
    assert one["payload_bits"]["state"] > 0


def test_a_run_is_resumed_from_the_copy_in_its_folder(tmp_path: Path) -> None:
    path = written(tmp_path / "way.csv", winding(2, times=90))
    flown = scenario_of(path, method="mfgfl-h", duration=85.0)
    whole = flight(tmp_path / "whole", flown)
    folder = dead(tmp_path, flown, 150)
    path.unlink()
    assert (folder / "vehicle" / "way.csv").exists()
    assert back(folder).scenario.vehicle.file == str(folder / "vehicle" / "way.csv")
    assert resumed(folder)["trajectory_sha256"] == whole["trajectory_sha256"]


def test_a_flight_begins_with_the_remark_that_commands_have_no_effect(tmp_path: Path) -> None:
    engine = Engine(scenario_of(written(tmp_path / "way.csv", winding(2))), "trace")
    assert [event.text for event in engine.world.begun().events] == [
        "the commands of cruise have no effect: the vehicle trace replays recorded movement"
    ]


GOOD = "t_s,uav,x_m,y_m\n0,0,0,0\n0,1,9,0\n1,0,1,0\n1,1,9,1\n"
BAD_FILES: dict[str, tuple[str, str]] = {  # content, and a part of the error
    "no column": (
        GOOD.replace("y_m", "lat"),
        "no column y_m; it needs t_s, uav, x_m, y_m, and has 't_s', 'uav', 'x_m', 'lat'",
    ),
    "spaces": (
        GOOD.replace(",", ", "),
        "it has no column uav and no x_m and no y_m; it needs t_s, uav, x_m, y_m, and has 't_s', ' uav'",
    ),
    "a date": (
        GOOD.replace("\n0,", "\n2026-11-21,").replace("\n1,", "\n2026-11-22,"),
        "row 1: `t_s` is '2026-11-21'; give a number of seconds",
    ),
    "a column twice": ("t_s,t_s,uav,x_m,y_m\n0,0,0,0,0\n", "it has the column t_s 2 times; leave the others out"),
    "a third axis": ("t_s,uav,x_m,y_m,z_m\n0,0,0,0,5\n", "a column z_m, and the flight is in the plane; set"),
    "no rows": ("t_s,uav,x_m,y_m\n", "it has no rows; give each UAV one at least"),
    "nothing": ("", "Empty CSV file"),
    "a short row": (GOOD + "2,0,3\n", "Expected 4 columns, got 3"),
    "a text": (GOOD.replace("0,1,9,0", "0,1,east,0"), "row 2: `x_m` is 'east'; give a number"),
    "a name": (GOOD.replace(",1,", ",veh1,"), "row 2: `uav` is 'veh1'; give a number"),
    "an empty cell": (GOOD.replace("1,0,1,0", "1,0,1,"), "row 3: `y_m` is empty or NaN; give a number"),
    "NaN": (GOOD.replace("1,0,1,0", "1,0,nan,0"), "row 3: `x_m` is empty or NaN; give a number"),
    "infinite": (GOOD.replace("1,0,1,0", "1,0,inf,0"), "row 3: `x_m` is inf; give a finite number"),
    "long ago": (
        GOOD.replace("1,0,1,0", "-1e308,0,1,0"),
        "row 3: `t_s` is -1e+308; no time is 1e+12 s away; give seconds",
    ),
    "far away": (GOOD.replace("1,0,1,0", "1,0,1e9,0"), "row 3: `x_m` is 1e+09; no place is 1e+08 m away"),
    "half a UAV": (GOOD.replace("1,0,1,0", "1,0.5,1,0"), "row 3: `uav` is 0.5; number UAVs from 0"),
    "a UAV below 0": (GOOD.replace("1,0,1,0", "1,-1,1,0"), "row 3: `uav` is -1; number UAVs from 0"),
    "a number left out": (GOOD.replace(",1,", ",2,"), "row 2: `uav` is 2, and there are 2 UAVs; number them 0…1"),
    "one UAV more": (GOOD + "0,2,5,5\n", "it has 3 UAVs, and 2 fly; set `uavs`, or the `count` of the group, to 3"),
    "a time twice": (GOOD + "1,1,9,2\n", "row 5: `t_s` of UAV 1 is 1 s, as in row 4; keep one of the rows"),
    "back in time": (GOOD + "0.5,1,9,2\n", "row 5: `t_s` of UAV 1 is 0.5 s before that of row 4; sort the rows by t_s"),
    "a gap": (GOOD + "9,1,9,2\n", "row 5: `t_s` of UAV 1 is 8 s after row 4, more than `vehicle.options.gap_s` 5 s"),
    "a jump": (
        GOOD + "2,1,250,1\n",
        "row 5: `x_m`, `y_m`: UAV 1 is 241 m from row 4 after 1 s, 241 m/s, and the bound",
    ),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_refused_with_file_row_and_column(name: str, tmp_path: Path) -> None:
    content, expected = BAD_FILES[name]
    path = tmp_path / "bad.csv"
    path.write_text(content)
    with pytest.raises(BadInput, match=re.escape(expected)) as caught:
        plan_of(scenario_of(path, uavs=2, **{"vehicle.options.gap_s": 5.0}))
    assert str(path) in str(caught.value)


def test_a_file_that_is_not_there_or_of_another_format_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "text.parquet"
    text.write_text(GOOD)
    for path, expected in (
        (
            tmp_path / "none.csv",
            "No such file or directory; name a file of this machine in `vehicle.options.file`, from the working folder",
        ),
        (text, "not a parquet file.; give a valid Parquet file"),
        (tmp_path / "way.txt", r"the format is unknown; give a file whose name ends in .parquet or .csv"),
        (tmp_path, "the format is unknown"),
    ):
        with pytest.raises(BadInput, match=expected):
            plan_of(scenario_of(path, uavs=2))


def test_a_file_of_more_rows_than_fit_in_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "way.parquet", winding(2))
    monkeypatch.setattr(f"{Tracks.__module__}._ROW_BYTES", 2**50)
    with pytest.raises(
        BadInput, match=r"it has 200 rows, which need 209,715,200 GiB, and this machine has .* GiB; keep"
    ):
        plan_of(scenario_of(path))


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"start.positions": ((0.0, 0.0), (9.0, 0.0))}, "leave out `start.positions`"),
        (
            {"start.formation": "circle"},
            "`start.formation` has no effect, because the UAVs start where the trace begins",
        ),
        ({"start.interval": 3.0}, "`start.interval` has no effect"),
        ({"space.dimensions": 3}, "no column z_m; add it, or set `space.dimensions` 3 to 2"),
        ({"vehicle.options.begin_s": 7.0}, "`vehicle.options.begin_s` is 7 s, and it lasts from 0 to 1 s"),
        ({"vehicle.options.sha256": "0" * 64}, f"and the scenario wants {'0' * 64}; bring that file back, or leave"),
        ({"obstacles": ({"centre": (9.0, 0.0), "radius": 1.0},)}, "UAV 1 starts inside `obstacles"),
        ({"vehicle.options.speed_max_m_s": 0.5}, "and the bound is 0.5 m/s; raise `vehicle.options.speed_max_m_s`"),
    ],
)
def test_keys_that_contradict_a_trace_are_refused(keys: dict[str, Any], expected: str, tmp_path: Path) -> None:
    path = tmp_path / "way.csv"
    path.write_text(GOOD)
    flown = scenario_of(path, uavs=2, **keys)  # it opens no file
    with pytest.raises(BadInput, match=expected):
        plan_of(flown)


def test_starts_of_the_default_formation_are_not_checked(tmp_path: Path) -> None:
    path = tmp_path / "way.csv"
    path.write_text(GOOD)
    station = ({"place": (150.0, 100.0, 40.0)},)
    keys: dict[str, Any] = {"stations": station, "obstacles": ({"centre": (150.0, 100.0), "radius": 5.0},)}
    assert plan_of(scenario_of(path, uavs=2, **keys)).given.start.positions == ((0.0, 0.0), (9.0, 0.0))


def test_the_title_of_the_paths_says_that_commands_had_no_effect(tmp_path: Path) -> None:
    path = tmp_path / "way.csv"
    path.write_text(GOOD)
    title = mf.fly(scenario_of(path, uavs=2)).plot("paths").axes[0].get_title(loc="left")
    assert title.splitlines()[1:] == ["the UAVs replay recorded movement: commands have no effect"]


def test_a_file_is_read_once_until_it_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read, seen = tracks.read, list[Path]()
    monkeypatch.setattr(tracks, "read", lambda path, axes: seen.append(path) or read(path, axes))
    path = written(tmp_path / "way.csv", winding(2))
    for seed in (1, 2):
        Engine(scenario_of(path, seed=seed), "trace")
    assert seen == [path]
    rows = winding(2)
    written(path, [*rows, (rows[-1][0] + 1.0, *rows[-1][1:])])
    Engine(scenario_of(path), "trace")
    assert seen == [path, path]


def test_a_scenario_that_names_the_wrong_starts_does_not_fly(tmp_path: Path) -> None:
    path = tmp_path / "way.csv"
    path.write_text(GOOD)
    planned = plan_of(scenario_of(path, uavs=2)).scenario
    with pytest.raises(BadInput, match=r"the UAVs start elsewhere; leave out `start.positions`"):
        Engine(planned.replace(**{"start.positions": ((0.0, 0.0), (8.0, 0.0))}), "trace")


def test_the_example_is_what_its_script_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    examples = Path(__file__).parents[2] / "examples"
    monkeypatch.setattr(sys, "argv", ["make_trace.py", str(tmp_path / "trace.parquet")])
    runpy.run_path(str(examples / "make_trace.py"), run_name="__main__")
    read = [parquet.read_table(folder / "trace.parquet") for folder in (tmp_path, examples)]
    assert read[0].equals(read[1])
    flown = scenarios.load(None, ["vehicle.model=trace", f"vehicle.options.file={examples / 'trace.parquet'}"])
    assert Engine(flown.replace(method="cruise"), "trace").complete()["arrived"] == 25


# -- one group of several ------------------------------------------------------------------------------------------


def grouped(path: Path, **keys: Any) -> Scenario:
    """Three UAVs that fly, five that move as a file says, and two that fly."""
    cars = {"name": "cars", "count": 5, "vehicle": {"model": "trace", "options": {"file": str(path)}}}
    chosen = {
        "uavs": 10,
        "dt": DT,
        "duration": 15.0,
        "method": "cruise",
        "stop": "duration",
        "radio.plausible_speed": 99,
    }
    groups = [{"name": "ahead", "count": 3}, cars | keys, {"name": "behind", "count": 2, "method": "lqr"}]
    return Scenario().replace(**chosen, groups=groups)


def test_a_refusal_of_a_scenario_with_the_starts_of_a_file_names_its_source_once(tmp_path: Path) -> None:
    given = grouped(written(tmp_path / "way.csv", winding(2))).replace(**{"energy.battery_J": 1e-3})
    with pytest.raises(BadInput, match=r"^mine.toml: `energy.battery_J` 0.001 J leaves"):
        plan_of(given, "mine.toml")


def test_a_group_moves_as_its_file_says_beside_others(tmp_path: Path) -> None:
    path = written(tmp_path / "way.csv", winding(2))
    given = grouped(path)
    flown = plan_of(given).scenario
    places = np.array([row[2:] for row in winding(2)]).reshape(-1, 5, 2)
    np.testing.assert_array_equal(state.position(mission.starts(flown))[3:8], places[0])
    np.testing.assert_array_equal(mission.starts(flown)[:3], mission.starts(Scenario(uavs=10))[:3])
    engine = Engine(given, "cars")
    for tick in engine.fly():
        if tick % 2 == 0:
            np.testing.assert_array_equal(state.position(engine.world.flight.states)[3:8], places[tick // 2])
    assert engine.world.flight.distance[[0, 1, 2, 8, 9]].min() > 1.0
    (event,) = ignored(flown)
    assert event.text.startswith("the commands of cruise have no effect")
    other = written(tmp_path / "elsewhere.csv", winding(2))
    assert grouped(other).sha256() == given.sha256() == flown.sha256()
    assert grouped(written(tmp_path / "way2.csv", winding(2, times=30))).sha256() != given.sha256()


def test_a_run_has_a_copy_of_the_file_of_each_group_and_resumes_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("meanflock.launch.engine._CHECKPOINT_TICKS_AT_MOST", 10)
    path = written(tmp_path / "way.csv", winding(2))
    flown = grouped(path)
    whole = flight(tmp_path / "whole", flown)
    folder = dead(tmp_path / "dead", flown, 17)
    path.unlink()
    assert (folder / "vehicle/cars/way.csv").exists()
    assert resumed(folder)["trajectory_sha256"] == whole["trajectory_sha256"]


def test_what_a_group_contradicts_is_refused_with_its_name(tmp_path: Path) -> None:
    path = written(tmp_path / "way.csv", winding(2, uavs=4))
    with pytest.raises(
        BadInput, match=r"group 'cars': trace .*it has 4 UAVs, and 5 fly; set `uavs`, or the `count` of the group, to 4"
    ):
        plan_of(grouped(path))
    with pytest.raises(BadInput, match=r"group 'cars': .*`start.formation` has no effect"):
        plan_of(grouped(path, count=5, start={"formation": "circle"}))
