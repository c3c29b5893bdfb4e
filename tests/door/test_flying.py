"""`mf.fly` and `mf.open`: a flight from Python is the one the command flies, whoever calls it and wherever."""

import csv
import json
import os
import signal
import threading
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.groundstation.cli.command import main

SMALL: dict[str, Any] = {"uavs": 4, "seed": 3, "duration": 6.0}


class Still(mf.Controller):
    """Commands nothing."""

    name = "still"

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> dict[str, np.ndarray]:
        return {"uav": uavs.astype(np.int32)}

    def step(self, memory: dict[str, np.ndarray], tick: int, own: np.ndarray, received: Any) -> mf.Step:
        return mf.Step(memory, np.zeros((len(own), 2)))


def commanded(tmp_path: Path, capsys: pytest.CaptureFixture[str], *flags: str) -> dict[str, Any]:
    """The summary the command prints of the same flight."""
    line = ["run", "--in-process", "--no-record", "--json", "--quiet", "--out", str(tmp_path / "command"), *flags]
    assert main([*line, "--uavs", "4", "--seed", "3", "--duration", "6"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_flight_is_that_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    expected = commanded(tmp_path, capsys, "--method", "hjb", "--set", "wind.sigma=0.2")
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
    found: list[str] = []

    def fly() -> None:
        found.append(mf.fly(method="mfg", **SMALL).summary["trajectory_sha256"])

    threads = [threading.Thread(target=fly) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [here, here]
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == handlers


def test_a_class_is_a_method() -> None:
    run = mf.fly(method=Still, **SMALL)
    assert run.summary["method"] == "still"
    assert mf.fly(method=Still, **SMALL).summary["trajectory_sha256"] == run.summary["trajectory_sha256"]
    assert np.isfinite(run.states).all()
    assert run.summary["arrived"] == 0


def test_a_class_leaves_a_folder_too(tmp_path: Path) -> None:
    run = mf.fly(method=Still, out=tmp_path, record=True, **SMALL)
    assert run.folder is not None
    again = mf.open(run.folder)
    np.testing.assert_array_equal(again.states, run.states)
    assert run.recording == again.recording is not None


def test_numbers_and_arrays_of_numpy_are_values() -> None:
    settings: dict[str, Any] = {"wind.sigma": np.float64(0.2), "wind.mean": np.array([0.5, -0.5])}
    run = mf.fly(method=Still, uavs=np.int64(4), seed=np.int32(3), duration=np.float32(6.0), **settings)
    assert (run.scenario.seed, run.scenario.wind.sigma, run.scenario.wind.mean) == (3, 0.2, (0.5, -0.5))
    assert mf.fly(mf.Scenario(uavs=1, duration=np.float64(1.0))).summary["ticks"] == 10


def test_files_of_plugins_are_one_or_several(tmp_path: Path) -> None:
    head = "import numpy as np\nimport meanflock as mf\n"
    (one := tmp_path / "still.py").write_text(
        f"{head}class One(mf.Controller):\n    name = 'one'\n    parameters = 1\n"
        "    def init(self, uavs, plan):\n        return {'w': np.ones((len(uavs), 1))}\n"
        "    def step(self, memory, tick, own, received):\n        return mf.Step(memory, 0.0 * own[:, :2])\n"
        "    def get(self, memory):\n        return memory['w']\n"
        "    def set(self, memory, rows, models):\n        return memory\n"
    )
    (other := tmp_path / "least.py").write_text(
        f"{head}class Least(mf.Aggregator):\n    name = 'least'\n"
        "    def step(self, state, uploads):\n        return state, uploads.models.min(axis=0)\n"
    )
    run = mf.fly(method="one", plugin=[one, str(other)], **SMALL, **{"federation.aggregation": "least"})
    assert run.summary["method"] == "one"


def test_a_plugin_that_calls_it_a_day_ends_no_process_but_its_own_part() -> None:
    class Leaves(Still):
        name = "leaves"

        def step(self, memory: dict[str, np.ndarray], tick: int, own: np.ndarray, received: Any) -> mf.Step:
            raise SystemExit(3)

    run = mf.fly(method=Leaves, **SMALL)
    assert run.summary["lost"] == 4
    assert any("SystemExit: 3" in event["text"] for event in run.events)


def test_a_diagnostic_called_as_a_column_is_refused_before_the_flight() -> None:
    class Clash(Still):
        name = "clash"
        diagnostics = ("x_m",)

    with pytest.raises(mf.BadInput, match="x_m: the time series has columns of that name"):
        mf.fly(method=Clash, **SMALL)


def test_a_scenario_is_a_name_a_file_a_scenario_or_nothing(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('method = "mfg"\nuavs = 4\nseed = 3\nduration = 6.0\n')
    hashes = {
        mf.fly(flown, **options).summary["trajectory_sha256"]
        for flown, options in (
            (path, {}),
            (str(path), {}),
            (mf.Scenario(method="mfg", uavs=4, seed=3, duration=6.0), {}),
            ("paper", {"method": "mfg", **SMALL}),
            (None, {"method": "mfg", **SMALL}),
        )
    }
    assert len(hashes) == 1


@pytest.mark.parametrize(
    ("scenario", "options", "says"),
    [
        ("paper", {"wind.sgima": 1}, "sgima"),
        ("paper", {"wind.sigma": -1}, "wind.sigma"),
        ("paper", {"wind.sigma": object()}, "wind.sigma"),
        ("paper", {"wind": 3}, "wind"),
        ("paper", {"uavs": 0}, "uavs"),
        ("paper", {"method": "nobody"}, "'nobody' is not installed here"),
        ("paper", {"method": int}, "derive a class from meanflock.Controller"),
        ("paper", {"method": object()}, "is neither the name nor the class of a controller"),
        ("paper", {"plugin": ["nowhere.py"]}, "nowhere.py"),
        ("paper", {"plugin": "nowhere.py"}, "nowhere.py"),
        ("paper", {"record": True}, "out="),
        ("nowhere.toml", {}, "nowhere.toml"),
        ("no such scenario", {}, "no such scenario"),
    ],
)
def test_bad_input_is_said_in_a_line_and_nothing_is_flown(
    scenario: str, options: dict[str, Any], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("meanflock.flying.Engine", lambda *_, **__: pytest.fail("flown in vain"))
    out = {} if "record" in options else {"out": "runs"}
    with pytest.raises(mf.BadInput) as caught:
        mf.fly(scenario, **out, **options)
    assert says in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert os.listdir(tmp_path) == []


def test_progress_is_reported() -> None:
    seen: list[tuple[int, int]] = []
    mf.fly(method="mfg", uavs=1, duration=25.0, stop="duration", progress=lambda tick, most: seen.append((tick, most)))
    assert seen == [(100, 250), (200, 250)]


# -- what is left of it -----------------------------------------------------------------------------------------------


def test_a_folder_is_opened_as_what_was_flown(tmp_path: Path) -> None:
    run = mf.fly(method="mfgfl-h", out=tmp_path, **SMALL)
    assert run.folder is not None
    again = mf.open(run.folder)
    assert again.summary == json.loads((run.folder / "summary.json").read_text()) == run.summary
    assert again.scenario.sha256() == run.scenario.sha256()
    assert again.scenario == again.scenario.resolved() == run.scenario.resolved() != run.scenario
    np.testing.assert_array_equal(again.states, run.states)
    assert again.events == run.events
    assert again.frame().equals(run.frame())
    assert again.recording is None


def test_a_frame_is_a_row_a_tick() -> None:
    run = mf.fly(method="mfg", **SMALL)
    table = run.frame()
    assert table["tick"].to_pylist() == list(range(61))
    x_m = np.array(table["x_m"].to_pylist())
    np.testing.assert_array_equal(x_m, run.states[:, :, 0])


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> mf.Run:
    """A run that left a folder."""
    return mf.fly(method="mfgfl-h", out=tmp_path_factory.mktemp("runs"), **SMALL)


@pytest.mark.parametrize("per", ["uav", "tick"])
def test_a_csv_file_holds_every_float_of_the_frame(
    per: Any, left: mf.Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert left.folder is not None
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


def test_a_long_frame_is_a_row_a_tick_and_uav(left: mf.Run) -> None:
    table = left.frame("uav")
    assert set(left.frame().column_names) > set(table.column_names) - {"uav"}
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


def test_a_csv_file_that_is_not_whole_is_not_there(
    left: mf.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("meanflock.groundstation.results.timeseries_file._ENTRIES", 40)
    (path := tmp_path / "flight.csv").write_text("old")
    ticks: list[tuple[int, int]] = []

    def interrupt(done: int, wanted: int) -> None:
        ticks.append((done, wanted))
        if done > 30:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        left.to_csv(path, progress=interrupt)
    assert ticks == [(10, 61), (20, 61), (30, 61), (40, 61)]
    assert (os.listdir(tmp_path), path.read_text()) == (["flight.csv"], "old")
    with pytest.raises(mf.BadInput, match=r"nowhere/flight\.csv: .*; name a file in a folder that can be written"):
        left.to_csv(tmp_path / "nowhere" / "flight.csv")
    with pytest.raises(mf.BadInput, match="per: 'row'; give \"uav\""):
        left.to_csv(path, "row")  # type: ignore[arg-type]
    assert main(["plot", str(left.folder), "--per", "tick"]) == 2


def test_a_recording_is_made_where_it_is_asked_for(tmp_path: Path) -> None:
    run = mf.fly(method="mfg", out=tmp_path, record=True, **SMALL)
    assert run.recording is not None
    assert run.recording.stat().st_size > 0


def test_what_cannot_be_opened_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(mf.BadInput, match="no run"):
        mf.open(tmp_path)
    run = mf.fly(method="mfg", out=tmp_path, **SMALL)
    assert run.folder is not None
    (run.folder / "summary.json").write_text("{")
    with pytest.raises(mf.BadInput, match="not JSON"):
        mf.open(run.folder)
    (run.folder / "summary.json").unlink()
    with pytest.raises(mf.BadInput, match="has not finished"):
        mf.open(run.folder)
