"""Comparisons and sweeps: flights, values, plug-ins, tables, one recording of several; processes that die."""

import os
import signal
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from rerun.chunk import RrdReader

import meanflock as mf
from meanflock.cli.study_tables import counts_table, means_table, payload_table, until_table
from meanflock.cli.tables import print_table
from meanflock.launch.engine import Engine
from meanflock.launch.station import StoredTelemetry
from meanflock.recording import blueprint as look
from meanflock.recording.replay import verify
from meanflock.results.quantities import COMPARED
from meanflock.studies import runner, side_by_side, study
from meanflock.studies.markdown import replaced, table
from meanflock.studies.means import Means
from meanflock.studies.store import Store
from meanflock.studies.swept import Swept
from meanflock.swarm import plugins, state
from meanflock.swarm.errors import EXIT_DONE, BadInput, RunFailed
from meanflock.swarm.scenario import load
from meanflock.swarm.toml import apply
from tests.controller_files import controller_file
from tests.groundstation.recordings import column, scalars
from tests.studies.conftest import QUICK, flown, rows

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.mark.parametrize(
    ("swept", "flags", "wanted"),
    [
        (
            "method=hjb,mfg",
            ("--seeds", "2", "--uavs", "2"),
            [("hjb", 2, 1), ("hjb", 2, 2), ("mfg", 2, 1), ("mfg", 2, 2)],
        ),
        ("seed=5,9", ("--scenario", "mine.toml"), [("mfg", 2, 5), ("mfg", 2, 9)]),
        ("uavs=2,3", ("--methods", "mfg", "--seeds", "1"), [("mfg", 2, 1), ("mfg", 3, 1)]),
    ],
)
def test_method_seed_and_uavs_are_swept_like_any_key(run, tmp_path, swept, flags, wanted) -> None:
    (tmp_path / "mine.toml").write_text('method = "mfg"\nuavs = 2\n')
    code, out, err = run("sweep", swept, *flags, *QUICK)
    assert (code, err) == (EXIT_DONE, "")
    assert [(one["method"], one["uavs"], one["seed"]) for one in flown(tmp_path / "out")] == wanted
    column = swept.partition("=")[0]
    assert column in out
    (label,) = [name for name in rows(tmp_path / "out/sweep.csv")[0] if name.startswith(column)][:1]
    assert [row[label] for row in rows(tmp_path / "out/sweep.csv")] == swept.partition("=")[2].split(",")


def test_several_keys_are_a_grid_with_a_row_for_each_flight(run, tmp_path: Path) -> None:
    code, out, err = run("sweep", "wind.sigma=0.1,0.2", "method=plan,hjb", "uavs=2,3", "--seeds", "2", *QUICK)
    assert (code, err) == (EXIT_DONE, "")
    assert max(map(len, out.splitlines())) <= 80
    keys = ("wind.sigma", "method", "uavs")
    grid = [(sigma, method, uavs) for sigma in ("0.1", "0.2") for method in ("plan", "hjb") for uavs in ("2", "3")]
    flights = rows(tmp_path / "out/flights.csv")
    wanted = [(*point, seed) for point in grid for seed in "12"]
    assert [tuple(row[name] for name in (*keys, "seed")) for row in flights] == wanted
    assert [tuple(row.values())[:3] for row in rows(tmp_path / "out/sweep.csv")] == grid
    table = pq.read_table(tmp_path / "out/flights.parquet")
    assert table.column_names == list(flights[0])
    assert table["energy_mean_J"].to_pylist() == [one["energy_mean_J"] for one in flown(tmp_path / "out")]
    for name in ("flights.csv", "flights.parquet", "sweep.png"):
        assert f"out/{name}" in out


RULE = "\nclass Rule(mf.Aggregator):\n    name = 'mine'\n\n    def step(self, state, uploads):\n        return 1 / 0\n"


def test_flights_that_lost_uavs_or_whose_rounds_were_all_void_are_counted(run, tmp_path) -> None:
    step = "if 1 in memory['uav']:\n    raise KeyError('rare')\nreturn mf.Step(memory, own[:, :2])"
    plugin = controller_file(tmp_path, "mine", step)
    init = "    def init(self, uavs, plan):\n        return {'uav': uavs}\n"
    plugin.write_text(plugin.read_text() + init + RULE)
    _, _, err = run("sweep", "uavs=2,3", "--methods", "mine", "--plugin", plugin.name, "--seeds", "2", *QUICK)
    assert [line for line in err.splitlines() if line.startswith("warning: ")] == [
        "warning: flights that lost UAVs: 4 of 4, 4 UAVs",
        "warning: in 4 of 4 flights: controller 'mine' failed with UAV 1: KeyError: 'rare' (mine.py, line 9)",
    ]
    rounds = ("--set", "federation.aggregation=mine", "--set", "federation.period=10", "--methods", "mfgfl-hf")
    _, _, err = run("sweep", "uavs=2,3", *rounds, "--plugin", plugin.name, "--seeds", "2", *QUICK[:-1], "void")
    failed = "aggregator 'mine' failed in round 1: ZeroDivisionError: division by zero (mine.py, line 18)"
    void = "warning: flights whose rounds were all void: 4 of 4"
    assert err.splitlines() == [void, f"warning: in 4 of 4 flights: {failed}"]
    assert not any("failures" in row for row in rows(tmp_path / "void/flights.csv"))
    _, _, err = run(
        "sweep", "uavs=2,3", *rounds[2:], "--set", "radio.target_snr_db=120", "--seeds", "1", *QUICK[:-1], "no"
    )
    assert err.splitlines()[-1].endswith("all void: 2 of 2; `meanflock run` with the values of one says why")


def test_python_prints_the_warnings_of_the_command(run, tmp_path, capsys) -> None:
    step = "import numpy\nreturn mf.Step(memory, numpy.random.normal(size=(len(own), 2)))"
    draws = controller_file(tmp_path, "draws", step)
    fails = controller_file(tmp_path, "fails", "return None")
    files = ("--plugin", draws.name, "--plugin", fails.name)
    _, _, err = run("compare", "draws", "fails", *files, "--seeds", "2", "--uavs", "2", *QUICK)
    warned = [line for line in err.splitlines() if line.startswith("warning: ")]
    assert [line.partition(";")[0] for line in warned] == [
        "warning: flights that lost UAVs: 2 of 4, 4 UAVs",
        "warning: in 2 of 4 flights: controller 'draws' draws from a global random generator, so other processes fly "
        "another flight",
        "warning: in 2 of 4 flights: controller 'fails' failed with UAVs 0, 1: TypeError: `step` returns a NoneType",
    ]
    mf.compare(["draws", "fails"], plugin=[draws, fails], seeds=2, uavs=2, duration=3.0)
    assert [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: ")] == warned


@pytest.mark.parametrize(
    ("swept", "label"),
    [("wind.sigma=0.1,0.2", "wind.sigma (m/s/√s)"), ("radio.fading=amplitude,power", "radio.fading")],
)
def test_a_sweep_is_drawn_along_numbers_or_names(run, undrawn, swept: str, label: str) -> None:
    assert run("sweep", swept, "--methods", "mfg", "--seeds", "1", "--uavs", "2", *QUICK)[0] == EXIT_DONE
    assert {(len(figure.axes), figure.axes[-1].get_xlabel()) for figure in undrawn} == {(len(COMPARED), label)}


def test_values_are_words_numbers_lists_or_tables() -> None:
    assert Swept.parse("radio.fading=amplitude, power").values == ("amplitude", "power")
    assert Swept.parse("federation.period=50,100").values == (50, 100)
    lists = Swept.parse("wind.mean=[1, -1],[0.5, 0.5]")
    assert [load(None, [lists.setting(value)]).wind.mean for value in lists.values] == [(1.0, -1.0), (0.5, 0.5)]
    discs = Swept.parse("obstacles=[], [{centre = [30.0, 0.0], radius = 2.0}]")
    assert [len(load(None, [discs.setting(value)]).obstacles) for value in discs.values] == [0, 1]
    words = Swept.parse("""x=["a, b", "it's", "\\n"], [true]""")
    apply(table := {}, words.setting(words.values[0]))
    assert table == {"x": ["a, b", "it's", "\n"]}
    with pytest.raises(BadInput, match="KEY=VALUE"):
        Swept.parse("wind.sigma")


def test_a_changed_plugin_flies_again(tmp_path: Path) -> None:
    """The folder `out` has the flights of an earlier form of the file."""

    def energy(name: str, push: float) -> list[float]:
        controller_file(tmp_path, name, f"return mf.Step(memory, own[:, :2] * {push})")
        out = tmp_path / "out"
        return [
            row["energy_mean_J"]
            for row in mf.compare(
                [name], plugin=tmp_path / f"{name}.py", seeds=2, jobs=1, out=out, uavs=2, duration=2.0
            )
        ]

    first = energy("one", -0.01)
    assert energy("other", -0.02) != first
    assert energy("one", -0.02) == energy("other", -0.02) != first


SCENARIOS = {name: load(None, method=name, uavs=3, duration=4.0, stop="duration") for name in ("mfgfl-h", "hjb")}


def test_compare_records_every_flight_under_its_own_name_on_one_timeline(run, tmp_path: Path) -> None:
    flags = ("--seeds", "1", "--uavs", "3", "--duration", "4", "--set", "stop=duration", "--jobs", "1", "--quiet")
    code, out, _ = run("compare", *SCENARIOS, "--record", *flags, "--out", "out")
    assert (code, "out/compare.rrd" in out.splitlines()) == (EXIT_DONE, True)
    path = tmp_path / "out/compare.rrd"
    summaries = {summary["method"]: summary for summary in flown(tmp_path / "out")}
    assert verify(path) is None
    parts = {chunk.entity_path.partition("/")[2].partition("/")[0] for chunk in RrdReader(path).stream()}
    assert parts - {"", "__properties"} == {side_by_side.part_of(name) for name in SCENARIOS}
    for name, scenario in SCENARIOS.items():
        kept, part = StoredTelemetry(), side_by_side.part_of(name)
        alone = Engine(scenario, "alone", sinks=[kept]).complete()
        assert summaries[name]["trajectory_sha256"] == alone["trajectory_sha256"]
        states = np.concatenate([block.states for block in kept.blocks])
        ticks, positions = column(path, f"{part}/{look.UAVS}", "Points2D:positions")
        np.testing.assert_array_equal(ticks, np.arange(41))
        np.testing.assert_array_equal(np.array(positions), state.position(states).astype(np.float32))
        _, energy = scalars(path, f"{part}/{side_by_side.ENERGY}")
        assert energy[-1, 0] == pytest.approx(alone["energy_end_mean_J"])
        _, bits = scalars(path, f"{part}/{side_by_side.BITS}")
        assert bits[-1, 0] == pytest.approx(alone["payload_bits"]["total"] / 1e6)


DIES = """marker = Path(__file__).with_suffix(".died")
if os.getpid() != {parent} and self.scenario.seed == 2 and not marker.exists():
    {mark}
    os.kill(os.getpid(), signal.SIGKILL)
return mf.Step(memory, 0.0 * own[:, :2])"""


@pytest.mark.processes
def test_a_flight_whose_process_dies_is_tried_twice(tmp_path: Path) -> None:
    """The second of four flights kills its process, once or always; a repeated study flies the rest."""

    def hashes(mark: str, jobs: int, out: Path) -> list[str]:
        step, top = DIES.format(parent=os.getpid(), mark=mark), "import os, signal\nfrom pathlib import Path"
        file = controller_file(tmp_path, "dying", step, top)
        plugins.load_files([file])
        flights = study.seeded(load(None, method="dying", uavs=2, duration=1.0), 4)
        flown = study.fly_all({"dying": flights}, jobs, lambda *_: None, Store(out))
        return [summary["trajectory_sha256"] for summary in flown["dying"]]

    alone, pool = hashes("pass", 1, tmp_path / "alone"), tmp_path / "pool"
    with pytest.raises(RunFailed, match=rf"died twice.* of 4 runs are kept in {pool}"):
        hashes("pass", 2, pool)
    assert hashes("marker.touch()", 2, pool) == alone
    assert (tmp_path / "dying.died").exists()


@pytest.mark.processes
def test_a_plugin_file_that_changes_before_a_process_has_read_it_is_refused(tmp_path: Path) -> None:
    file = controller_file(tmp_path, "changing", "return mf.Step(memory, 0.0 * own[:, :2])")
    plugins.load_files([file])
    flights = study.seeded(load(None, method="changing", uavs=2, duration=1.0), 2)
    file.write_text(file.read_text().replace("0.0", "0.5"))
    with pytest.raises(BadInput, match=rf"{file}: was changed since it was loaded"):
        study.fly_all({"changing": flights}, 2, lambda *_: None, Store(tmp_path / "out"))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_processes_start_waits_for_the_end_of_the_block(number: signal.Signals) -> None:
    done: list[object] = []
    before = signal.signal(number, lambda number, _: done.append(number))
    try:
        with runner._signals_deferred():
            signal.raise_signal(number)
            done.append("started")
    finally:
        signal.signal(number, before)
    assert done == ["started", number]


def test_negative_numbers_of_jobs_count_down_from_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(4), raising=False)
    assert [runner._number_of(jobs) for jobs in (-9, -4, -2, -1, 1, 7)] == [1, 1, 3, 4, 1, 7]


def test_table_and_csv_have_the_means_of_the_flights(run, tmp_path) -> None:
    """The destination is so wide that some UAVs arrive at once and others are on their way at the end."""
    flags = ("--set", "destination.radius=178", "--set", "start.spacing=4", "--uavs", "3", "--seeds", "2")
    code, out, _ = run("compare", "mfg", *flags, *QUICK)
    assert code == EXIT_DONE
    runs = flown(tmp_path / "out")
    arrived = sum(one["arrived"] for one in runs) / 2
    assert 0 < arrived < 3
    expected = sum((one["t_avg_s"] * one["arrived"] + 3.0 * (3 - one["arrived"])) / 3 for one in runs) / 2
    (row,) = rows(tmp_path / "out/compare.csv")
    assert float(row["t_avg_censored_s"]) == pytest.approx(expected)
    assert (float(row["arrived_uavs"]), row["n"]) == (arrived, "2")
    for words in (f"{arrived:.4g}/3", f"{expected:.4g}", "counts with the duration"):
        assert words in " ".join(out.split())
    for name in ("compare.png", "compare.svg", "compare.csv", "compare.tex", "study.json"):
        assert f"out/{name}" in out


LARGE = {"uavs": 25, "arrived": 25, "lost": 0, "obstacle_hits": 0, "rounds": 0, "rounds_void": 0}
LARGE |= {"t_avg_censored_s": 161.3456, "energy_mean_J": 148.2859, "collisions": 99.875}
LARGE |= {"phi_A": 1.23456, "phi_C_distinct": 1.234567e-5}
LARGE["payload_bits"] = {"uplink": 9e8, "relay": 0, "broadcast": 0, "state": 87_654_321, "total": 987_654_321}
DISCS = "[{'x': 10.0, 'y': 20.0, 'radius': 3.0}, {'x': 30.0, 'y': 20.0, 'radius': 3.0}]"


def test_further_counts_are_shown_if_any_flight_has_one(capsys: pytest.CaptureFixture[str]) -> None:
    flights = {("orca",): [LARGE, LARGE], ("cruise",): [LARGE | {"lost": 1}, LARGE | {"obstacle_hits": 5, "lost": 2}]}
    assert counts_table(Means(("method",), {("orca",): [LARGE]})) is None
    table = counts_table(Means(("method",), flights))
    assert table is not None
    print_table(table)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[2:5] == [["obstacle"], ["lost", "hits"], ["method", "(UAVs)", "(1)"]]
    assert lines[6:] == [["orca", "0", "0"], ["cruise", "1.5", "2.5"]]


def test_what_it_cost_to_reach_a_bound_is_a_mean_over_the_flights_that_reached_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    cost = {"round": 3, "time_s": 15.1, "bits": 4e8, "airtime_s": 0.5, "energy_J": 70.0}
    flights = [LARGE | {"until": {"reached": at is not None} | (cost | {"round": at})} for at in (3, 4, None)]
    assert until_table(Means(("method",), {("hjb",): [LARGE | {"until": None}]})) is None
    table = until_table(Means(("method",), {("fast",): flights, ("slow",): flights[2:]}))
    assert table is not None
    print_table(table)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[-2:] == [
        ["fast", "2/3", "3.5", "15.1", "400", "0.5", "70"],
        ["slow", "0/1", "–", "–", "–", "–", "–"],
    ]
    assert ["method", "flights", "round", "(s)", "(Mbit)", "(s)", "(J)"] in lines


@pytest.mark.parametrize("columns", [20, 80])
@pytest.mark.parametrize(
    ("key", "values"), [("federation.broadcast_payload", ("float16", "int8")), ("obstacles", ("[]", DISCS))]
)
def test_a_table_of_means_fits_80_columns_and_cuts_no_number(key, values, columns, monkeypatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    points = {(value, method): [LARGE] * 8 for value in values for method in ("mfgfl-hf", "offline")}
    means = Means((key, "method"), points)
    by_kind = payload_table(means)
    print_table(by_kind)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= max(80, columns)
    assert "relay" not in shown
    assert all(word in shown for word in ("uplink", "state", "(Mbit)", "87.65"))
    table = means_table(means, "sweep: 25 UAVs", [300.0])
    print_table(table)
    shown = capsys.readouterr().out
    lines = shown.splitlines()
    assert max(map(len, lines)) <= max(80, columns)
    assert "…" not in shown
    assert all(sum(method in line.split() for line in lines) == 2 for method in ("mfgfl-hf", "offline"))
    assert all(word in shown for value in values for word in str(value).split())
    for word in ("(UAVs)", "(s)", "(J)", "(Mbit)", "φ_A", "(m/s)", "(1)", "(pairs)", "25/25", "1.235e-05", "161.3"):
        assert word in shown


@pytest.mark.parametrize(
    ("names", "points", "said"),
    [
        (("wind.sigma", "method"), [(0.1, "plan"), (0.2, "plan")], "every other row, ? is"),
        (("method",), [("plan",), ("hjb",)], "every other row, ? is"),
        (("uavs", "method"), [(3, "plan"), (3, "hjb"), (4, "plan")], "every row that differs in method only, ? is"),
        (
            ("uavs", "training.learner", "method"),
            [(3, "a", "plan"), (3, "b", "hjb"), (4, "a", "plan")],
            "every row that differs in learner or method only, ? is",
        ),
    ],
)
def test_the_note_of_a_table_names_the_rows_that_are_compared(names, points, said) -> None:
    flights = [[LARGE | {"phi_A": place + seed} for seed in (0.0, 0.5)] for place in range(len(points))]
    note = means_table(Means(names, dict(zip(points, flights, strict=True))), "", [300.0]).caption
    assert f" * is significantly better than {said} undecided (paired by seed, Holm's method)." in note
    single_flights = Means(names, {point: [LARGE] for point in points})
    note = means_table(single_flights, "", [300.0]).caption
    assert note.endswith(" Which row is significantly best is unknown: each has one flight.")
    single_row = Means(names, {points[0]: [LARGE]})
    note = means_table(single_row, "", [300.0]).caption
    assert note.endswith("Lower is better everywhere but in arrivals.")


def test_a_cell_breaks_no_table() -> None:
    assert table(("a", "b"), [("|x|", "two\nlines")]) == ["| a | b |", "|---|---|", "| \\|x\\| | two lines |"]


def test_only_the_text_between_its_two_marks_is_replaced() -> None:
    page = "# A page\n<!-- a -->\nold\n<!-- end -->\n<!-- b -->\nkept\n<!-- end -->\n"
    assert replaced(page, "<!-- a -->", "<!-- end -->", ["new"]) == page.replace("old", "new")
    for wrong in ("# A page\n", "<!-- a -->", "<!-- a --><!-- end --><!-- a --><!-- end -->"):
        with pytest.raises(ValueError, match=r"places for `<!-- a -->`"):
            replaced(wrong, "<!-- a -->", "<!-- end -->", [])
