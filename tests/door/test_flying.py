"""`mf.fly`, `mf.open`, `mf.compare`, `mf.sweep`: flights from Python are those of the command; imports load nothing."""

import csv
import hashlib
import json
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatchcase
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import meanflock as mf
from meanflock import env, swarm
from meanflock.cli.command import main
from meanflock.comparison import Comparison
from meanflock.results.quantities import COMPARED, DERIVED, SUMMARY
from meanflock.studies import study
from tests.agent.learning.lines import FLOWN, Line
from tests.commands import loaded, printed
from tests.testing.good import GoodVehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL: dict[str, Any] = {"uavs": 4, "seed": 3, "duration": 6.0}


class Still(mf.Controller):
    """Commands nothing."""

    name = "still"

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> dict[str, np.ndarray]:
        return {"uav": uavs.astype(np.int32)}

    def step(self, memory: dict[str, np.ndarray], tick: int, own: np.ndarray, received: Any) -> mf.Step:
        return mf.Step(memory, np.zeros((len(own), 2)))


class Clash(Still):
    """Reports a diagnostic that is called as a column."""

    name = "clash"
    diagnostics = ("x_m",)


def test_a_flight_is_that_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["run", "--in-process", "--no-record", "--json", "--quiet", "--out", str(tmp_path / "command")]
    line += ["--uavs", "4", "--seed", "3", "--duration", "6", "--method", "hjb", "--set", "wind.sigma=0.2"]
    assert main(line) == 0
    expected = json.loads(capsys.readouterr().out)
    run = mf.fly("paper", method="hjb", **SMALL, **{"wind.sigma": 0.2})
    assert run.summary["trajectory_sha256"] == expected["trajectory_sha256"]
    assert run.scenario.wind.sigma == 0.2
    assert run.states.shape == (61, 4, 4)
    assert run.folder is None
    assert run.recording is None
    assert {"joined", "finished"} <= {event["kind"] for event in run.events}


def test_any_thread_flies_and_no_signal_handler_is_touched() -> None:
    handlers = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    here = mf.fly(method="mfg", **SMALL).summary["trajectory_sha256"]
    with ThreadPoolExecutor(2) as pool:
        runs = list(pool.map(lambda _: mf.fly(method="mfg", **SMALL), range(2)))
    assert {run.summary["trajectory_sha256"] for run in runs} == {here}
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == handlers


def test_a_class_is_a_method_and_values_of_numpy_are_values(tmp_path: Path) -> None:
    settings: dict[str, Any] = {"wind.sigma": np.float64(0.2), "wind.mean": np.array([0.5, -0.5])}
    options: dict[str, Any] = {"uavs": np.int64(4), "seed": np.int32(3), "duration": np.float32(6.0)}
    run = mf.fly(method=Still, out=tmp_path, record=True, **options, **settings, **{"vehicle.model": GoodVehicle})
    assert run.scenario.vehicle.model == "good"
    assert (run.scenario.seed, run.scenario.wind.sigma, run.scenario.wind.mean) == (3, 0.2, (0.5, -0.5))
    assert (run.summary["method"], run.summary["arrived"]) == ("still", 0)
    assert run.recording.stat().st_size > 0
    assert mf.open(run.folder).recording == run.recording


def test_files_of_plugins_are_one_or_several() -> None:
    settings = {"federation.aggregation": "momentum", "federation.options.beta": 0.9}
    run = mf.fly(method="trim", plugin=[EXAMPLES / "trim.py", str(EXAMPLES / "momentum.py")], **SMALL, **settings)
    assert (run.summary["method"], run.scenario.federation.aggregation) == ("trim", "momentum")


def test_a_scenario_is_a_name_a_file_a_scenario_or_nothing(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('method = "mfg"\nuavs = 4\nseed = 3\nduration = 2.0\n')
    options: dict[str, Any] = {"method": "mfg", "uavs": 4, "seed": 3, "duration": 2.0}
    flown = [mf.fly(path), mf.fly(str(path)), mf.fly(mf.Scenario(**options)), mf.fly("paper", **options)]
    assert len({run.summary["trajectory_sha256"] for run in (*flown, mf.fly(**options))}) == 1


FEW: dict[str, Any] = {"uavs": 2, "duration": 3.0, "jobs": 1}
OUT = {"out": "runs"}


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: mf.fly("paper", **OUT, **{"wind.sgima": 1}), "sgima"),
        (lambda: mf.fly("paper", method=int, **OUT), "derive a class from meanflock.Controller"),
        (lambda: mf.fly("paper", method=object(), **OUT), "is neither the name nor the class of a controller"),
        (lambda: mf.compare(5, **FEW), "is neither the name nor the class of a controller"),
        (
            lambda: mf.fly("paper", method=GoodVehicle, **OUT),
            "method: GoodVehicle is a vehicle; give the name or the class",
        ),
        (
            lambda: mf.fly("paper", method="plan", learner=Still, **OUT),
            "--learner: Still is a controller; give the name or",
        ),
        (
            lambda: mf.fly("paper", **{"radio.model": Still}, **OUT),
            "radio.model: Still is a controller; give the name or",
        ),
        (
            lambda: mf.fly("paper", **{"wind.mean": {0.1, 0.2}}, **OUT),
            "wind.mean: a scenario has no values of type set",
        ),
        (
            lambda: mf.fly({"uavs": 2}, **OUT),
            "scenario: {'uavs': 2}; give the name of a shipped one, a TOML file or a Sc",
        ),
        (lambda: mf.Scenario({"uavs": 2}), "scenario: {'uavs': 2}; give each key by its name: mf.Scenario(uavs=9)"),
        (lambda: mf.fly("paper", progress=True, **OUT), "progress: True; give a function of two numbers"),
        (lambda: mf.fly("paper", progress=len, **OUT), "progress: <built-in function len>; give a function of two"),
        (lambda: mf.Stepped("paper", progress="yes"), "progress: 'yes'; give a function of two numbers"),
        (lambda: mf.compare("mfg", progress=True, **FEW), "progress: True; give a function of two numbers"),
        (lambda: mf.fly("paper", plugin=b"mine.py", **OUT), "b'mine.py' is no path of a file; give a text or a Path"),
        (lambda: mf.fly("paper", out=b"runs"), "b'runs' is no path of a file; give a text or a Path"),
        (lambda: mf.fly("paper", method=Clash, **OUT), "x_m: the time series has columns of that name"),
        (lambda: mf.fly("paper", plugin=5, **OUT), "5 is no path of a file"),
        (lambda: mf.fly("paper", learner=5, **OUT), "--learner: 5 is no learner; give its name, its class or its file"),
        (
            lambda: mf.fly("swop", **OUT),
            "swop: No such file or directory; give a readable scenario, or name one of crowd",
        ),
        (lambda: mf.fly("runs/s1", **OUT), "runs/s1: No such file or directory; give a readable scenario"),
        (lambda: mf.fly("paper", record=True), "out="),
        (lambda: mf.fly("nowhere.toml", **OUT), "nowhere.toml"),
        (lambda: mf.fly("patrol", method="offline", **OUT), "patrol: `energy.battery_J` sends UAVs home"),
        (lambda: mf.fly("patrol", learner="nowhere.py", **OUT), "--learner nowhere.py: No such file"),
        (lambda: mf.Stepped("paper", record=True), "record=True"),
        (lambda: mf.compare([], seeds=2, **FEW), "name a controller"),
        (lambda: mf.compare(["mfg"], seeds=0, **FEW), "seeds: 0; give how many"),
        (lambda: mf.sweep("wind.sigma", [], **FEW), "a value or more"),
        (lambda: mf.sweep("wind.sigma", [0.1], seeds=2, **FEW | {"jobs": "2"}), "jobs: '2'; give a number"),
        (lambda: mf.sweep("wind.sigma", [0.1], **{"wind.sigma": 0.2}, **FEW), "leave it out"),
        (lambda: mf.sweep("method", ["mfg"], methods="hjb", **FEW), "leave it out of the methods"),
        (lambda: mf.sweep("wind.sigma", [0.1], methods="hjb", **{"wind.sigma": 0.2}, **FEW), "out of the settings"),
        (lambda: mf.sweep("wind.sigma", [0.1], methods=[], **FEW), "sweep: name a controller or more"),
        (lambda: mf.compare("plan", learner="nowhere.py", **FEW), "--learner nowhere.py: No such file"),
        (
            lambda: mf.sweep("training.learner", ["line"], learner=Line, method="plan", **FEW),
            "training.learner is what is swept; leave it out of the settings",
        ),
        (lambda: mf.compare([], **FEW), "compare: name a controller or more"),
        (lambda: mf.compare("hjb", method="mfg", **FEW), "compare: both `methods` and `method`"),
        (lambda: mf.sweep("wind.sigma", [0.1], methods="hjb", method="mfg", **FEW), "sweep: both `methods` and"),
        (lambda: mf.fly(**{"federation.aggregation": 3}, **OUT), "nor the class of an aggregator"),
        (lambda: mf.sweep(["wind.sigma", "uavs"], [[0.1, 0.2]], **FEW), "2 keys, and values for 1"),
        (lambda: mf.sweep(["wind.sigma", "wind.sigma"], [[0.1], [0.2]], **FEW), "swept twice"),
        (lambda: mf.sweep(["wind.sigma", "uavs"], [0.1, 0.2], **FEW), "wind.sigma: 0.1; give a list"),
        (lambda: mf.sweep("method", "hjb", **FEW), "give a list"),
        (lambda: mf.sweep([], [], **FEW), "0 keys"),
        (lambda: mf.sweep(3, [1], **FEW), "sweep: 3: [1]; give a key, or a list of keys, and a list of values"),
        (lambda: mf.sweep("uavs", 3, **FEW), "sweep: 'uavs': 3; give a key, or a list of keys, and a list of values"),
        (lambda: env.vector_env("paper", reward={"speed": 1.0}), "no term 'speed'"),
        (lambda: env.vector_env("paper", neighbours=0), "neighbours: 0"),
        (lambda: env.vector_env("paper", message=99), "message: 99"),
        (lambda: env.vector_env("paper", acceleration=-1.0), "acceleration: -1.0"),
        (lambda: env.vector_env("paper", **{"wind.sgima": 1}), "sgima"),
        (lambda: mf.fly(method="hjb", uavs=90_000, **OUT), "GiB for 90000 UAVs in one process"),
        (lambda: mf.compare(["mfg", "hjb"], seeds=1, uavs=90_000, **OUT), "GiB for 90000 UAVs in one process"),
        (lambda: mf.open("."), "no run"),
    ],
)
def test_bad_input_is_one_line_and_nothing_flies(call: Any, says: str, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for engine in ("meanflock.flying.Engine", "meanflock.studies.study.fly_all"):
        monkeypatch.setattr(engine, lambda *_, **__: pytest.fail("flown in vain"))
    with pytest.raises(mf.BadInput) as caught:
        call()
    assert says in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert os.listdir(tmp_path) == []


def test_classes_of_plugins_are_swept_by_their_names() -> None:
    rows = mf.sweep("vehicle.model", ["point-mass", GoodVehicle], methods=Still, seeds=1, **FEW)
    assert [row["vehicle.model"] for row in rows] == ["point-mass", "good"]


def test_a_learner_that_is_given_trains_in_each_flight() -> None:
    given = {"seeds": 1, "learner": Line} | FLOWN
    swept = mf.sweep("federation.topology", ["leader", "neighbours"], **given)
    compared = mf.compare([given.pop("method"), "straight"], **given)
    assert set(compared.rounds()["learner"].to_pylist()) == {"line"}
    assert compared["plan"]["last_round_mean_loss"] == swept["leader"]["last_round_mean_loss"]


def test_progress_is_reported() -> None:
    seen: list[tuple[int, int]] = []
    mf.fly(method="mfg", uavs=1, duration=25.0, stop="duration", progress=lambda tick, most: seen.append((tick, most)))
    assert seen == [(100, 250), (200, 250)]


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> mf.Run:
    """A run that left a folder."""
    return mf.fly(method="mfgfl-h", out=tmp_path_factory.mktemp("runs"), **SMALL)


def test_an_opened_folder_is_the_run_that_was_flown(left: mf.Run) -> None:
    again = mf.open(left.folder)
    assert again.summary == json.loads((left.folder / "summary.json").read_text()) == left.summary
    assert again.scenario == again.scenario.resolved() == left.scenario.resolved() != left.scenario
    np.testing.assert_array_equal(again.states, left.states)
    assert again.events == left.events
    assert again.frame().equals(left.frame())
    assert again.recording is None


@pytest.mark.parametrize("per", ["uav", "tick"])
def test_a_csv_file_holds_every_float_of_the_frame(per: Any, left, tmp_path, capsys) -> None:
    path = left.to_csv(tmp_path / "flight.csv", per)
    with path.open() as file:
        header, *rows = csv.reader(file)
    table = left.frame(per)
    flat = [field.name for field in table.schema if not str(field.type).startswith("list")]
    assert header == flat
    assert header[:3] == ["tick", "sim_time_s", "uav" if per == "uav" else "uplink_bits"]
    assert len(rows) == len(table) == 61 * (4 if per == "uav" else 1)
    for number, name in enumerate(header):
        assert [float(row[number]) if row[number] else None for row in rows] == table[name].to_pylist(), name
    assert main(["plot", str(left.folder), "--csv", str(tmp_path / "command.csv"), "--per", per]) == 0
    assert (tmp_path / "command.csv").read_bytes() == path.read_bytes()
    assert capsys.readouterr().out.split() == [str(tmp_path / "command.csv")]
    assert mf.open(left.folder).to_csv(tmp_path / "opened.csv", per).read_bytes() == path.read_bytes()


def test_a_frame_has_a_row_for_each_tick_or_each_tick_and_uav(left: mf.Run) -> None:
    table = left.frame("uav")
    assert set(left.frame().column_names) > set(table.column_names) - {"uav"}
    ticks = left.frame()
    assert ticks["tick"].to_pylist() == list(range(61))
    np.testing.assert_array_equal(np.array(ticks["x_m"].to_pylist()), left.states[:, :, 0])
    states = np.stack([table[name].to_numpy() for name in ("x_m", "y_m", "vx_m_s", "vy_m_s")], axis=-1)
    np.testing.assert_array_equal(states, left.states.reshape(-1, 4))
    assert table["uav"].to_pylist()[:5] == [0, 1, 2, 3, 0]
    assert table["tick"].to_pylist()[3:5] == [0, 1]
    assert table.schema.field("x_m").metadata[b"unit"] == b"m"
    if find_spec("pandas"):
        assert left.to_pandas().groupby("uav")["energy_J"].max().shape == (4,)
    else:
        with pytest.raises(mf.BadInput, match="pandas is not installed; `pip install pandas`, or use"):
            left.to_pandas()


def test_a_csv_file_that_cannot_be_written_is_bad_input(left: mf.Run, tmp_path: Path) -> None:
    with pytest.raises(mf.BadInput, match=r"nowhere/flight\.csv: .*; name a file in a folder that can be written"):
        left.to_csv(tmp_path / "nowhere" / "flight.csv")
    with pytest.raises(mf.BadInput, match="per: 'row'; give \"uav\""):
        left.to_csv(tmp_path / "flight.csv", "row")
    assert not list(tmp_path.iterdir())


def test_a_folder_without_a_finished_run_is_bad_input(left: mf.Run, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(left.folder, tmp_path / "run"))
    for name, junk, says in (
        ("events.jsonl", b"junk\n", r"events\.jsonl: damaged"),
        ("events.jsonl", b"", r"events\.jsonl: No such file"),
        ("summary.json", b"{", "not JSON"),
        ("summary.json", b"", "has not finished"),
    ):
        (folder / name).write_bytes(junk)
        if not junk:
            (folder / name).unlink()
        with pytest.raises(mf.BadInput, match=says):
            _ = mf.open(folder).events


LOOK = """
import os, signal, sys
before = dict(os.environ), signal.getsignal(signal.SIGINT)
import meanflock
names = dir(meanflock)
assert (dict(os.environ), signal.getsignal(signal.SIGINT)) == before
"""


def test_importing_loads_nothing_and_changes_nothing(tmp_path: Path) -> None:
    libraries = {"numpy", "msgspec", "msgpack", "zenoh", "pyarrow", "rerun", "click"}
    ours = {name for name in loaded(LOOK, cwd=tmp_path) if name.startswith("meanflock")}
    assert (ours, loaded(LOOK, cwd=tmp_path) & libraries) == ({"meanflock"}, set())
    assert [name for name in dir(mf) if not name.startswith("__")] == sorted(mf.__all__)
    assert all(getattr(mf, name) is not None for name in dir(mf))
    assert not hasattr(mf, "flie")


FAILING = """import meanflock as mf

class Failing(mf.Channel):
    name = "failing"

    def transmit(self, distance_m, bits, rng):
        return 1 / 0
"""


def test_the_error_of_a_flight_that_failed_says_what_its_folder_has(tmp_path: Path) -> None:
    plugin = tmp_path / "my channel.py"
    plugin.write_text(FAILING)
    keys = {"plugin": plugin, "method": "orca", "radio.model": "failing", **SMALL}
    with pytest.raises(mf.RunFailed, match=r"^channel 'failing': failed: .*$"):
        mf.fly("paper", **keys)
    with pytest.raises(mf.RunFailed) as caught:
        mf.fly("paper", out=tmp_path / "my runs", **keys)
    (folder,) = (tmp_path / "my runs").iterdir()
    assert f"\n{folder} has the flight up to tick " in str(caught.value)
    again = str(caught.value).partition("`")[2].partition("`")[0]
    assert shlex.split(again) == ["meanflock", "run", str(folder / "scenario.toml"), "--plugin", str(plugin)]


def test_controllers_are_compared_by_the_means_of_the_same_seeds() -> None:
    found = mf.compare(["mfg", "hjb"], seeds=3, **FEW)
    assert [(row["method"], row["n"], row["uavs"]) for row in found] == [("mfg", 3, 2), ("hjb", 3, 2)]
    assert [found["mfg",], found["hjb"]] == list(found)
    with pytest.raises(mf.BadInput, match="'orca': no point of this study; name values of method: 'mfg'; 'hjb'"):
        found["orca"]
    assert repr(mf.compare("mfg", seeds=1, **FEW)) == "<Comparison of 1 point of method: 1 flight>"
    for row, ((method,), summaries) in zip(found, found.summaries.items(), strict=True):
        assert [summary["seed"] for summary in summaries] == [1, 2, 3]
        alone = mf.fly(method=method, uavs=2, duration=3.0, seed=2)
        assert summaries[1]["trajectory_sha256"] == alone.summary["trajectory_sha256"]
        mean = np.mean([summary["energy_mean_J"] for summary in summaries])
        assert row["energy_mean_J"] == pytest.approx(mean)
        assert row["energy_mean_J_low"] < mean < row["energy_mean_J_high"]


def test_a_key_is_swept_over_numbers_lists_and_tables() -> None:
    rows = list(mf.sweep("wind.sigma", np.linspace(0.1, 0.2, 2), methods=["mfg", "hjb"], seeds=np.int64(1), **FEW))
    found = [(row["wind.sigma"], row["method"]) for row in rows]
    assert found == [(0.1, "mfg"), (0.1, "hjb"), (0.2, "mfg"), (0.2, "hjb")]
    swept = mf.sweep("wind.sigma", [0.1, 0.2], methods=["mfg", "hjb"], seeds=1, **FEW)
    assert [swept[0.1, "mfg"], swept[0.2, "hjb"]] == [rows[0], rows[3]]
    for absent in (0.1, ("mfg", 0.1), (0.1, "mfg", 1), 0):
        with pytest.raises(mf.BadInput, match=r"name values of wind\.sigma, method: 0\.1, 'mfg'; "):
            swept[absent]
    lists = mf.sweep("wind.mean", [[1.0, -1.0], (0.0, 0.0)], methods="mfg", seeds=1, **FEW)
    assert [row["wind.mean"] for row in lists] == [(1.0, -1.0), (0.0, 0.0)]
    assert lists[0.0, 0.0] == lists[(0.0, 0.0), "mfg"] == list(lists)[1]
    assert repr(lists) == "<Comparison of 2 points of wind.mean, method: 2 flights>"
    disc = {"centre": [30.0, 0.0], "radius": 2.0}
    tables = mf.sweep("obstacles", [[], [disc]], methods="mfg", seeds=1, **FEW)
    assert [row["obstacles"] for row in tables] == [(), (str(disc),)]


@pytest.fixture(scope="module")
def grid() -> mf.Comparison:
    options: dict[str, Any] = {"seeds": 2, "duration": 3.0, "jobs": 1}
    return mf.sweep(["wind.sigma", "uavs"], [np.array([0.1, 0.2]), (2, 3)], methods=["plan", "hjb"], **options)


def test_several_keys_are_a_grid_and_its_frame_has_a_row_for_each_flight(grid: mf.Comparison, tmp_path: Path) -> None:
    assert [(row["wind.sigma"], row["uavs"], row["method"]) for row in grid] == [
        (sigma, uavs, method) for sigma in (0.1, 0.2) for uavs in (2, 3) for method in ("plan", "hjb")
    ]
    table = grid.frame()
    flown = [summary for summaries in grid.summaries.values() for summary in summaries]
    assert len(table) == 16 == len(flown)
    for key in ("seed", "arrived", "energy_mean_J", "t_avg_s", "models_sha256", "scenario_sha256", "t_avg_censored_s"):
        assert table[key].to_pylist() == [summary[key] for summary in flown]
    assert table["payload_bits.total"].to_pylist() == [summary["payload_bits"]["total"] for summary in flown]
    assert table["diagnostics_mean.phi_G"].to_pylist()[:2] == [None, None]  # `plan` reports none
    assert {str(table.schema.field(name).type) for name in ("t_avg_s", "radio.outage_rate", "uavs", "method")} == {
        *("double", "int64", "string")
    }
    described = {field.key for field in (*SUMMARY, *DERIVED)} | {"wind.sigma"}
    assert not [name for name in table.column_names if not any(fnmatchcase(name, key) for key in described)]
    assert pq.read_table(grid.to_parquet(tmp_path / "flights.parquet")).equals(table)
    with grid.to_csv(tmp_path / "flights.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["energy_mean_J"]) for row in rows] == table["energy_mean_J"].to_pylist()
    assert (rows[0]["t_avg_s"], list(rows[0])) == ("", table.column_names)


def test_values_that_are_lists_or_of_several_types_are_text_in_the_frame() -> None:
    lists = mf.sweep("wind.mean", [[1.0, -1.0], (0.0, 0.0)], methods="plan", seeds=1, **FEW)
    assert lists.frame()["wind.mean"].to_pylist() == ["[1.0, -1.0]", "[0.0, 0.0]"]
    compared = mf.compare(["plan", "hjb"], seeds=1, **FEW)
    assert compared.frame().column_names[:2] == ["method", "schema"]
    methods = mf.sweep("method", ["plan", "hjb"], seeds=1, **FEW)
    assert (list(methods.summaries), list(compared.summaries)) == ([("plan",), ("hjb",)],) * 2


def test_every_flight_says_what_flew_it() -> None:
    git = subprocess.run(["git", "rev-parse", "HEAD"], cwd=EXAMPLES, capture_output=True, text=True, check=False)
    commit = git.stdout.strip() or None  # None: the source is no checkout
    found = mf.fly(method="spring", plugin=EXAMPLES / "spring.py", **SMALL).summary["provenance"]
    source = hashlib.sha256((EXAMPLES / "spring.py").read_bytes()).hexdigest()
    assert (found["commit"], found["python"], found["numpy"]) == (commit, platform.python_version(), np.__version__)
    assert found["plugins"]["controller"] == f"spring, sha256 {source}"
    assert found["plugins"]["channel"] == f"rice, meanflock {swarm.__version__}"
    (summary,) = mf.compare("spring", seeds=1, uavs=2, duration=1.0, jobs=1).summaries[("spring",)]
    assert summary["provenance"] == found


def test_a_notebook_shows_runs_and_studies_and_their_plots(grid: mf.Comparison, left: mf.Run) -> None:
    here = mf.fly(method="orca", **SMALL)
    for run in (here, mf.open(left.folder)):
        page = run._repr_html_()
        assert (page.count("<svg"), f"{run.summary['arrived']} of 4 UAVs" in page) == (1, True)
        for what, panels in (("paths", 1), ("curves", 4 if run is here else 8)):
            figure = run.plot(what)
            titled = [ax.get_title(loc="left") for ax in figure.axes if ax.get_title(loc="left")]
            assert len(titled) == panels, titled  # none for a quantity that is 0 throughout
        assert figure._repr_png_().startswith(b"\x89PNG")
    page = grid._repr_html_()
    assert (page.count("<tr>"), page.count("<th ")) == (9, 4 + 7)
    hostile = Comparison(("<b>",), {("<script>\x1b",): [here.summary | {"t_avg_censored_s": 1.0}]})
    assert not re.findall("<script|<b>|\x1b", hostile._repr_html_())
    with pytest.raises(mf.BadInput, match="curves"):
        here.plot("map")


def test_a_grid_is_drawn_along_its_first_key_with_a_line_for_each_of_the_others(grid: mf.Comparison) -> None:
    figure = grid.plot()
    lines = [text.get_text() for text in figure.legends[0].get_texts()]
    assert lines == ["plan, uavs=2", "hjb, uavs=2", "plan, uavs=3", "hjb, uavs=3"]
    assert [ax.get_xlabel() for ax in figure.axes] == [*[""] * (len(COMPARED) - 2), *["wind.sigma (m/s/√s)"] * 2]
    energy = np.array([line.get_ydata() for line in figure.axes[1].get_lines() if len(line.get_ydata()) == 2])
    means = [row["energy_mean_J"] for row in grid]
    assert {tuple(row) for row in energy} >= {(means[k], means[k + 4]) for k in range(4)}
    rows = mf.compare(["plan", "hjb"], seeds=2, **FEW).plot()
    assert [label.get_text() for label in rows.axes[0].get_yticklabels()] == ["plan", "hjb"]


def test_what_was_registered_in_this_process_is_flown_in_it() -> None:
    class Mine(mf.Controller):
        name = "mine"

        def step(self, memory: Any, tick: int, own: Any, received: Any) -> mf.Step:
            return mf.Step(memory, -0.02 * own[:, :2])

    class First(mf.Aggregator):
        name = "first"

        def step(self, state: Any, uploads: mf.Uploads) -> Any:
            return state, uploads.models[0]

    mf.register(Mine)
    few = FEW | {"jobs": 2}
    assert [row["n"] for row in mf.compare(["mine", "plan"], seeds=2, **few)] == [2, 2]
    assert [row["n"] for row in mf.sweep("wind.sigma", [0.1], methods="mine", seeds=2, **few)] == [2]
    mf.register(First)
    assert [row["n"] for row in mf.compare("mfg", seeds=2, **{"federation.aggregation": "first"}, **few)] == [2]


@pytest.mark.parametrize("kept", [True, False])
def test_ctrl_c_is_a_keyboard_interrupt_and_names_the_kept_flights(kept: bool, tmp_path, monkeypatch) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(study.Store, "add", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        mf.compare("mfg", seeds=2, out=tmp_path if kept else None, **FEW)
    assert f"kept in {tmp_path / 'data'}" in str(caught.value) if kept else "nothing is kept: name" in str(caught.value)


FORKED = """
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import meanflock as mf

def flown(jobs=2):
    return [row["payload_bits"] for row in mf.compare("mfg", seeds=2, uavs=2, duration=1, jobs=jobs)]

if __name__ == "__main__":
    here, fork = flown(jobs=1), multiprocessing.get_context("fork")
    with ProcessPoolExecutor(1, mp_context=fork) as pool:
        assert pool.submit(flown).result() == here
    with fork.Pool(1) as pool:
        assert pool.apply(flown) == here
"""


@pytest.mark.processes
def test_flights_fly_in_a_fork_and_in_a_worker_of_another_pool(tmp_path: Path) -> None:
    script = tmp_path / "forked.py"
    script.write_text(FORKED)
    printed(sys.executable, "-W", "error", script, cwd=tmp_path)
