"""The files of a study of short flights: tidy frames, figures for print, a record that flies again, bad folders."""

import json
import os
import re
import shutil
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import meanflock as mf
from meanflock.cli import study_arguments
from meanflock.cli.command import main
from meanflock.results import statistics
from meanflock.results.plots import plotstyle
from meanflock.results.plots.learning import plot_learning
from meanflock.results.rounds_table import COLUMNS, OF_UAVS
from meanflock.studies import study
from meanflock.studies.study_file import sha256_of
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED
from meanflock.swarm.plugins import registry
from tests.studies.conftest import rows

GRID = ("radio.access=fdma,tdma", "federation.topology=leader,neighbours", "--methods", "fed-lspi")
SHORT = ("--uavs", "4", "--duration", "6", "--set", "stop=duration", "--jobs", "1", "--quiet")
PRINT = ("--pareto", "bits", "tracking_cost", "--figures", "pdf,svg", "--columns", "1", "--over", "bits")
KEYS = ["radio.access", "federation.topology", "method"]
LEARNERS = """
import numpy as np
import meanflock as mf


class {name}(mf.Learner):
    name = "{name}"
    metrics = ("accuracy",)

    @classmethod
    def initial(cls, options, scenario):
        return {{"w": np.zeros(2)}}

    def fit(self, model, config):
        w = model["w"] + {rate} * (1.0 - model["w"])
        return mf.Trained({{"w": w}}, 1.0, metrics={{"accuracy": float(w.mean())}})
"""


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("grid") / "out"
    assert main(["sweep", *GRID, "--seeds", "2", *SHORT, *PRINT, "--out", str(out)]) == EXIT_DONE
    return out


@pytest.fixture
def copy(grid: Path, tmp_path: Path) -> Path:
    """The folder of the grid, as someone else gets it: without the finished flights."""
    shutil.copytree(grid, tmp_path / "out", ignore=lambda *_: ["data"])
    return tmp_path / "out"


def alone(row: dict[str, Any]) -> mf.Run:
    keys = {name: row[name] for name in KEYS[:2]}
    return mf.fly(method=row["method"], seed=row["seed"], uavs=4, duration=6.0, stop="duration", **keys)


def test_a_flight_is_a_row_with_its_keys_its_numbers_and_their_units(grid: Path) -> None:
    table = pq.read_table(grid / "flights.parquet")
    assert table.column_names[:3] == KEYS
    assert [(*(row[name] for name in KEYS), row["seed"]) for row in table.to_pylist()] == [
        (access, topology, "fed-lspi", seed)
        for access in ("fdma", "tdma")
        for topology in ("leader", "neighbours")
        for seed in (1, 2)
    ]
    units = {field.name: (field.metadata or {}).get(b"unit") for field in table.schema}
    assert (units["energy_mean_J"], units["payload_bits.total"], units["radio.airtime_s"]) == (b"J", b"bits", b"s")
    assert not [name for name in table.column_names if name.startswith("each_round")]
    row = table.to_pylist()[5]
    assert row["trajectory_sha256"] == alone(row).summary["trajectory_sha256"]


def test_a_round_is_a_row_with_the_same_keys_and_the_numbers_of_the_run_alone(grid: Path) -> None:
    table = pq.read_table(grid / "rounds.parquet")
    assert table.column_names[: 4 + len(COLUMNS)] == [*KEYS, "seed", *COLUMNS]
    assert table["bits"].type == pa.int64()
    flight = next(
        row for row in pq.read_table(grid / "flights.parquet").to_pylist() if row["federation.topology"] != "leader"
    )
    rounds = [row for row in table.to_pylist() if all(row[name] == flight[name] for name in (*KEYS, "seed"))]
    expected = alone(flight).rounds().to_pylist()
    assert len(expected) > 1
    assert [{name: row[name] for name in expected[0]} for row in rounds] == expected


def test_a_learner_is_a_key_of_the_grid_and_a_column(
    run: Any, undrawn: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, rate in (("slow", 0.1), ("fast", 0.5)):
        (tmp_path / f"{name}.py").write_text(LEARNERS.format(name=name, rate=rate))
    keys = ("--set", "federation.period=20", "--set", "federation.fraction=1")
    wanted = ("--pareto", "bits", "accuracy", "--seeds", "2", "--out", "out")
    code, out, err = run(
        "sweep", "uavs=3,4", "--methods", "plan", "--learners", "slow.py", "fast.py", *SHORT[2:], *keys, *wanted
    )
    assert (code, err) == (EXIT_DONE, "")
    for file in ("flights", "rounds"):
        table = pq.read_table(tmp_path / "out" / f"{file}.parquet")
        assert table.column_names[:3] == ["uavs", "training.learner", "method"]
        assert set(table["learner"].to_pylist()) == {"slow", "fast"}
    places = {(row["uavs"], row["training.learner"]): row["pareto"] for row in rows(tmp_path / "out/sweep.csv")}
    assert places["3", "slow"] == "dominated"
    assert places["3", "fast"] == "front"
    assert re.search(r"3 +fast +2 .*front", out)
    code, _, _ = run("study", "rerun", "out/study.json", "--jobs", "1", "--quiet")
    assert code == EXIT_DONE  # this process has the learners
    with monkeypatch.context() as another:  # a process without them
        another.setattr(registry, "registered", {})
        code, _, err = run("study", "rerun", "out/study.json", "--jobs", "1", "--quiet")
    assert code == EXIT_BAD_INPUT
    copies = "--plugin out/plugins/fast.py --plugin out/plugins/slow.py"
    assert f"is not installed here; read the copies of what flew, and name them: {copies}" in err
    assert run("sweep", "uavs=3,4", "--learners", "slow.py", "--learner", "fast.py", *SHORT[2:])[0] == EXIT_BAD_INPUT
    code, _, _ = run(
        "sweep", "training.learner=slow,fast", "--uavs", "3", "--methods", "plan", *SHORT[2:], *keys, "--seeds", "1"
    )
    assert code == EXIT_DONE


def test_a_study_with_two_plugin_files_of_one_name_flies_again_from_their_copies(
    run: Any, undrawn: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, rate in (("slow", 0.1), ("fast", 0.5)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text(LEARNERS.format(name=name, rate=rate))
    keys = ("--set", "federation.period=20", "--set", "federation.fraction=1", "--seeds", "1", "--out", "out")
    files = ("slow/mine.py", "fast/mine.py")
    code, _, err = run("sweep", "uavs=3,4", "--methods", "plan", "--learners", *files, *keys, *SHORT[2:])
    assert (code, err) == (EXIT_DONE, "")
    monkeypatch.setattr(registry, "registered", {})  # a process without them
    copies = [f"--plugin={path}" for path in sorted(Path("out/plugins").iterdir())]
    assert len(copies) == 2
    code, out, _ = run("study", "rerun", "out/study.json", *copies, "--jobs", "1", "--quiet")
    assert (code, out) == (EXIT_DONE, "All 4 flights are the same.\n")


def test_the_same_study_has_the_same_figures_with_embedded_fonts_of_the_printed_width(
    grid: Path, tmp_path: Path
) -> None:
    names = ["sweep", "learning-over-bits", "pareto"]
    assert sorted(path.name for path in grid.glob("*.*f")) == sorted(f"{name}.pdf" for name in names)
    assert main(["sweep", *GRID, "--seeds", "2", *SHORT, *PRINT, "--out", str(tmp_path / "again")]) == EXIT_DONE
    for name in names:
        for form in ("pdf", "svg"):
            content = (grid / f"{name}.{form}").read_bytes()
            assert content == (tmp_path / "again" / f"{name}.{form}").read_bytes()
            assert b"CreationDate" not in content
            assert b"<dc:date>" not in content
        pdf = (grid / f"{name}.pdf").read_bytes()
        assert b"/FontFile2" in pdf  # TrueType, embedded
        assert b"/Type3" not in pdf
        (width,) = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ", pdf)
        assert float(width) == pytest.approx(72 * plotstyle.WIDTHS_IN[1])
    assert not list(grid.glob("*.png"))


def test_fonts_of_figures_are_seven_points_at_least_and_formats_are_those_of_the_command() -> None:
    sizes = [value for key, value in plotstyle._RC.items() if re.search("font.?size|labelsize|titlesize", key)]
    assert len(sizes) >= 5
    assert min(sizes) >= 7.0
    assert sorted(plotstyle.FORMATS) == sorted(study_arguments.FORMATS)


def test_a_learning_curve_is_the_mean_of_the_rounds_that_all_flights_have_with_its_band(grid: Path) -> None:
    found: dict[tuple[Any, ...], dict[int, list[dict[str, Any]]]] = {}
    for row in pq.read_table(grid / "rounds.parquet").to_pylist():
        found.setdefault(tuple(row[name] for name in KEYS), {}).setdefault(row["seed"], []).append(row)
    points = {point: list(flights.values()) for point, flights in found.items()}
    first = next(iter(points))
    points[first][0].pop()  # a flight that ended earlier
    figure = plot_learning(KEYS, points, "bits")
    ax = figure.axes[0]
    assert ax.get_title(loc="left").startswith("(a) mean tracking_cost")
    line, flights = ax.lines[0], points[first]
    common = len(flights[0])
    assert len(line.get_xdata()) == common == len(flights[1]) - 1
    last = [flight[common - 1] for flight in flights]
    estimate = statistics.mean([row["mean_tracking_cost"] for row in last])
    assert line.get_ydata()[-1] == pytest.approx(estimate.value)
    assert line.get_xdata()[-1] == pytest.approx(np.mean([row["bits"] for row in last]))
    band = ax.collections[0].get_paths()[0].vertices
    assert {estimate.low, estimate.high} <= {*np.round(band[:, 1], 12)} | {estimate.low, estimate.high}
    assert band[:, 1].max() >= estimate.high
    caption = f"{OF_UAVS} mean and 95 % interval over 2 flights"
    assert figure.get_supxlabel().replace("\n", " ") == caption
    assert figure.get_supxlabel().splitlines()[-1] == "mean and 95 % interval over 2 flights"
    assert len(figure.legends[0].get_texts()) == len(points)
    drawn = plot_learning(KEYS, points | {first: [[], []]}, "bits")
    labels = [[text.get_text() for text in each.legends[0].get_texts()] for each in (figure, drawn)]
    assert labels[1] == labels[0][1:]  # a method without rounds has no line
    assert plot_learning(KEYS, {point: [[], []] for point in points}, "rounds") is None
    begun = {point: [flight[:1] for flight in flights] for point, flights in points.items()}
    (mark, *_), *_ = plot_learning(KEYS, begun, "rounds").axes[0].containers  # a line of one round would not be seen
    assert mark.get_marker() not in ("None", "")


def test_a_study_flies_again_and_is_the_same(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path.name: path.read_bytes() for path in copy.iterdir()}
    assert main(["study", "rerun", str(copy / "study.json"), "--jobs", "1", "--quiet"]) == EXIT_DONE
    assert capsys.readouterr().out == "All 8 flights are the same.\n"
    assert {path.name: path.read_bytes() for path in copy.iterdir()} == before


@pytest.mark.processes
@patch.dict(os.environ)  # Distributed sets variables of this process, and leaves them
def test_a_dask_cluster_flies_a_study_and_flies_it_again(
    grid: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed", reason="dask is not installed")
    cluster = ("--quiet", "--backend", "dask")
    assert main(["sweep", *GRID, "--seeds", "2", *SHORT, *cluster, "--out", str(tmp_path / "out")]) == EXIT_DONE
    hashes = ["trajectory_sha256", "models_sha256"]
    here, there = (pq.read_table(out / "flights.parquet").select(hashes) for out in (grid, tmp_path / "out"))
    assert here.equals(there)
    assert main(["study", "rerun", str(tmp_path / "out/study.json"), *cluster]) == EXIT_DONE
    assert "All 8 flights are the same." in capsys.readouterr().out


def test_a_study_of_recorded_movement_flies_again_elsewhere_by_its_copies_of_the_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two files have the same name, and both are gone."""
    monkeypatch.chdir(tmp_path)
    for folder, x in (("slow", 20), ("fast", 40)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "trace.csv").write_text(f"t_s,uav,x_m,y_m\n0,0,9,9\n9,0,{x},9\n0,1,9,30\n")
    files = "vehicle.options.file=slow/trace.csv,fast/trace.csv"
    flags = ("--methods", "cruise", "--set", "vehicle.model=trace", "--uavs", "2", *SHORT[2:], "--seeds", "1")
    assert main(["sweep", files, *flags, "--out", "out"]) == EXIT_DONE
    for folder in ("slow", "fast"):
        shutil.rmtree(tmp_path / folder)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    capsys.readouterr()
    assert main(["study", "rerun", str(tmp_path / "out/study.json"), "--jobs", "1", "--quiet"]) == EXIT_DONE
    assert capsys.readouterr().out == "All 2 flights are the same.\n"
    shutil.rmtree(tmp_path / "out/vehicle")
    assert main(["study", "rerun", str(tmp_path / "out/study.json"), "--jobs", "1", "--quiet"]) == EXIT_BAD_INPUT
    assert f"from the working folder {tmp_path / 'elsewhere'} on" in capsys.readouterr().err


def test_the_record_alone_is_enough_and_an_interrupted_rerun_flies_the_rest(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in copy.glob("*.parquet"):
        path.unlink()
    command = ["study", "rerun", str(copy / "study.json"), "--jobs", "1", "--quiet"]
    fly, flown = study.summarised, []

    def interrupted(scenario: mf.Scenario) -> dict[str, Any]:
        if len(flown) == 3:
            raise KeyboardInterrupt
        flown.append(scenario.seed)
        return fly(scenario)

    monkeypatch.setattr(study, "summarised", interrupted)
    assert main(command) == EXIT_RUN_FAILED
    assert "3 of 8 runs are kept" in capsys.readouterr().err
    monkeypatch.setattr(study, "summarised", lambda scenario: flown.append(scenario.seed) or fly(scenario))
    assert main(command) == EXIT_DONE
    assert len(flown) == 8
    assert not (copy / "rerun").exists()


def test_a_flight_that_differs_is_named_with_what_was_expected_and_found(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = json.loads((copy / "study.json").read_text())
    record["points"][1]["flights"][1]["trajectory_sha256"] = "0" * 64
    record["python"] = "3.1"
    (copy / "study.json").write_text(json.dumps(record))
    assert main(["study", "rerun", str(copy / "study.json"), "--jobs", "1", "--quiet"]) == EXIT_RUN_FAILED
    said = capsys.readouterr()
    (line,) = [line.split() for line in said.out.splitlines() if "trajectory" in line]
    assert line[:4] == ["fdma", "neighbours", "fed-lspi", "2"]
    assert "0" * 12 in line
    assert "1 of 8 flights differ" in said.err
    assert "note: flown with python 3.1, and here it is" in said.err


def test_a_number_that_differs_is_named_by_its_field(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = pq.read_table(copy / "flights.parquet")
    place = table.column_names.index("energy_mean_J")
    wrong = pa.array([99.5, *table["energy_mean_J"].to_pylist()[1:]])
    pq.write_table(table.set_column(place, "energy_mean_J", wrong), copy / "flights.parquet")
    record = json.loads((copy / "study.json").read_text())
    record["files"]["flights.parquet"] = sha256_of(copy / "flights.parquet")
    (copy / "study.json").write_text(json.dumps(record))
    assert main(["study", "rerun", str(copy / "study.json"), "--jobs", "1", "--quiet"]) == EXIT_RUN_FAILED
    said = capsys.readouterr().out
    assert re.search(r"energy_mean_J +99\.5 ", said)


def edit_beside_plugins(out: Path, **changes: Any) -> None:
    """Edit a record that has copies of plug-ins beside it, which are not at fault."""
    (out / "plugins").mkdir()
    (out / "plugins" / "mine.py").touch()
    edit(out, **changes)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda out: (out / "study.json").unlink(), "No such file"),
        (lambda out: (out / "study.json").write_bytes((out / "study.json").read_bytes()[:500]), "damaged"),
        (lambda out: (out / "study.json").write_text("[]"), "damaged"),
        (lambda out: (out / "rounds.parquet").write_bytes(b"PAR1"), "rounds.parquet: not the table of the study"),
        (lambda out: (out / "flights.csv").write_text("seed\n1\n"), "flights.csv: not the table of the study"),
        (lambda out: edit(out, meanflock="1.9.0"), "flown with meanflock 1.9.0.*pip install meanflock==1.9.0"),
        (lambda out: edit_beside_plugins(out, keys={"uavs": 5}), "hash .* than the record has; restore the file$"),
        (lambda out: edit(out, keys={"uvas": 5}), "did you mean `uavs`"),
        (lambda out: edit(out, schema=99), "damaged: schema 99, expected 1"),
        (lambda out: edit(out, points=[]), "damaged: no points"),
        (lambda out: edit(out, names=["zz"]), "damaged: point .* has 3 values of 1 names"),
        (lambda out: edit(out, points=points(out)[:1] * 2), "damaged: two points"),
        (lambda out: edit(out, points=[points(out)[0] | {"flights": []}]), "damaged: point .* has no flights"),
    ],
)  # fmt: skip
def test_a_study_that_is_not_whole_is_refused_and_nothing_is_flown(
    damage: Any, said: str, copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damage(copy)
    assert main(["study", "rerun", str(copy / "study.json"), "--quiet"]) == EXIT_BAD_INPUT
    assert re.search(said, capsys.readouterr().err)
    assert not (copy / "rerun").exists()


def points(out: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((out / "study.json").read_text())["points"]
    return found


def edit(out: Path, **changed: Any) -> None:
    record = json.loads((out / "study.json").read_text())
    for name, value in changed.items():
        record[name] = record[name] | value if isinstance(value, dict) else value
    (out / "study.json").write_text(json.dumps(record))


def test_more_seeds_and_values_join_a_study_and_another_one_is_refused(run: Any, undrawn: Any, tmp_path: Path) -> None:
    fixed = ("--methods", "plan", *SHORT, "--out", "out")
    assert run("sweep", "wind.sigma=0.1,0.2", "--seeds", "1", *fixed)[0] == EXIT_DONE
    first = sorted(path.name for path in (tmp_path / "out/data/jobs").iterdir())
    assert run("sweep", "wind.sigma=0.1,0.2,0.3", "--seeds", "2", *fixed)[0] == EXIT_DONE
    assert set(first) < {path.name for path in (tmp_path / "out/data/jobs").iterdir()}
    before = (tmp_path / "out/study.json").read_bytes()
    code, _, err = run("sweep", "wind.drag=0.1,0.2", "--seeds", "1", *fixed)
    assert code == EXIT_BAD_INPUT
    assert "out: it has another study, `meanflock sweep wind.sigma=0.1,0.2,0.3 --seeds 2" in err
    assert (tmp_path / "out/study.json").read_bytes() == before
    for unusable, said in (
        ('{"schema": 1, "nam', "damaged: "),
        ('{"meanflock": "1.0.0"}', "pip install meanflock==1.0.0"),
    ):
        (tmp_path / "out/study.json").write_text(unusable)
        code, _, err = run("sweep", "wind.sigma=0.1,0.2", "--seeds", "1", *fixed)
        assert (code, said in err, "or name another folder: --out DIR" in err) == (EXIT_BAD_INPUT, True, True)
    (tmp_path / "out/study.json").unlink()
    assert run("sweep", "wind.sigma=0.1,0.2", "--seeds", "1", *fixed)[0] == EXIT_DONE


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("wind.sgima=0.1,0.2",), "did you mean `wind.sigma`"),
        (("radio.access=fdma,aloha",), "aloha"),
        (("uavs=2,3", "--pareto", "bits", "colisions"), "did you mean 'collisions'"),
        (("uavs=2,3", "--pareto", "bits", "accuracy"), "--pareto accuracy: no flight has such a number"),
        (("uavs=2,3", "--pareto", "bits", "until.bits"), "--pareto until.bits: no flight ends at a metric"),
        (("uavs=2,3", "--figures", "gif"), "--figures gif: name formats, of pdf, png, svg"),
    ],
)
def test_what_no_flight_has_is_refused_before_any_flies(
    words: tuple[str, ...], said: str, run: Any, tmp_path: Path
) -> None:
    code, _, err = run("sweep", *words, "--methods", "plan", *SHORT[2:], "--out", "out")
    assert code == EXIT_BAD_INPUT
    assert said in err
    assert not (tmp_path / "out").exists()


LATE = "uavs = 2\n[[faults]]\nkind = 'kill'\ntime_s = 3.0\nuavs = [1]\n"
NEVER = "kill of UAV 1 never happens: it begins at 3 s, and `duration` is {} s"


def test_a_warning_says_at_which_points_it_holds_unless_at_all(
    run: Any, undrawn: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "late.toml").write_text(LATE)
    command = ("sweep", "wind.sigma=0.1,0.2", "--scenario", "late.toml", "--methods", "plan", "--seeds", "1")
    fixed = ("--jobs", "1", "--quiet")
    code, _, err = run(*command, "--duration", "2", *fixed, "--out", "all")
    assert (code, err.splitlines()) == (EXIT_DONE, [f"warning: {NEVER.format(2)}"])
    code, _, err = run(*command, "duration=1.0,2.0,4.0", "--set", "dt=0.5", *fixed, "--out", "some")
    assert (code, err.splitlines()) == (
        EXIT_DONE,
        [
            f"warning: at 2 of 6 points (sigma=0.1, duration={float(end)}; sigma=0.2, duration={float(end)}): "
            + NEVER.format(end)
            for end in (1, 2)
        ],
    )
    values = ",".join(f"{1.0 + number / 10}" for number in range(5))
    code, _, err = run("sweep", f"wind.drag={values}", "duration=2.0,4.0", *command[2:], *fixed, "--out", "many")
    listed = "; ".join(f"drag={1.0 + number / 10}, duration=2.0" for number in range(3))
    assert (code, err) == (EXIT_DONE, f"warning: at 5 of 10 points ({listed}; …): {NEVER.format(2)}\n")
    mf.sweep("duration", [1.0, 4.0], scenario=tmp_path / "late.toml", methods="plan", seeds=1, jobs=1)
    assert f"at 1 of 2 points (duration=1.0): {NEVER.format(1)}" in capsys.readouterr().err


def test_more_points_than_looks_are_warned_of(run: Any, undrawn: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plotstyle, "MOST_LOOKS", 3)
    command = ("--methods", "plan", "--uavs", "2", "--duration", "1", "--seeds", "1", "--jobs", "1", "--quiet")
    code, _, err = run("sweep", "wind.sigma=0.1,0.2,0.3", *command, "--out", "three")
    assert (code, err) == (EXIT_DONE, "")
    code, _, err = run("sweep", "wind.sigma=0.1,0.2", "wind.drag=1,2", *command, "--out", "four")
    assert code == EXIT_DONE
    assert err.startswith("warning: figures have 3 looks for 4 points, so some look alike; read those in the tables")


def test_every_table_of_a_grid_fits_a_terminal(run: Any, undrawn: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = run("sweep", *GRID, "--seeds", "2", *SHORT, *PRINT, "--out", "out")
    assert code == EXIT_DONE
    assert max(map(len, out.splitlines())) <= 80
    assert "Means over 2 flights each" in out
    assert "? is undecided" in out


def test_tables_say_that_no_number_differs_and_what_is_unknown(run: Any, undrawn: Any) -> None:
    swept = ("sweep", "federation.period=40,50", "--methods", "plan", "--seeds", "2", *SHORT)
    code, out, _ = run(*swept, "--pareto", "t_avg_s", "bits", "--out", "out")
    words = " ".join(out.split())
    assert code == EXIT_DONE
    assert "No number differs between the rows." in words
    assert sum(line.endswith(" unknown") for line in out.splitlines()) == 2
    assert "unknown: a flight of the point lacks one of the numbers." in words
