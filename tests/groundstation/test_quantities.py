"""Quantities and their files: one name and unit in tables, plots, recordings, pages and metadata; intervals."""

import io
import json
import math
import re
import shutil
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import matplotlib as mpl
import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rich.console import Console
from scipy import stats

from meanflock.launch.options import FlightOptions
from meanflock.launch.progress import summary_table
from meanflock.launch.run import fly
from meanflock.recording import plots
from meanflock.recording.plots import plot_rows
from meanflock.results import event_log, inbound, quantities, statistics
from meanflock.results.plots import plotstyle
from meanflock.results.plots.run import plot_run
from meanflock.results.quantities import FIELDS, Quantity
from meanflock.results.run_folder import EVENTS, SUMMARY
from meanflock.results.series import Reported, block_of, diagnostics_in
from meanflock.results.series import schema as schema_of
from meanflock.results.timeseries_file import TIMESERIES
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.events import KINDS, LEVELS, TYPES, Untyped
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import Status
from research.reproduction.curves import CRITERIA
from tests.groundstation.conftest import every_axis, plain, titles
from tests.groundstation.recordings import DIAGNOSTICS, flight

ROOT = Path(__file__).parents[2]
QUANTITIES = {value for value in vars(quantities).values() if isinstance(value, Quantity)}
FAULTS = [{"kind": "kill", "tick": 20, "uavs": [1]}, {"kind": "leader-loss", "tick": 250}]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders of short flights by method: with faults, and in real time where it learns most, but for `hjb`."""
    folders = {}
    for method, realtime in (("offline", None), ("mfgfl-hf", 200.0), ("hjb", None)):
        flown = load(None, method=method, uavs=4, duration=30.0, faults=FAULTS if method != "hjb" else [])
        out = tmp_path_factory.mktemp("runs")
        options = FlightOptions(out=out, in_process=True, record=False, quiet=True, realtime=realtime)
        folders[method] = fly(flown, options).folder
    return folders


@pytest.fixture(params=["offline", "mfgfl-hf"])
def run(request: pytest.FixtureRequest, runs: dict[str, Path]) -> Path:
    return runs[request.param]


def test_the_notation_has_every_name_with_its_unit_and_fields() -> None:
    section = (ROOT / "docs/notation.md").read_text(encoding="utf-8").split("## Names")[1].split("\n## ")[0]
    rows = {}
    for row in section.splitlines():
        if row.startswith("| "):
            name, unit, fields, _ = [cell.strip() for cell in row.replace("\\|", "¦").strip("|").split("|")]
            rows[name.replace("¦", "|")] = (unit, set(re.findall(r"`(\w+)`", fields)))
    assert set(FIELDS.values()) == QUANTITIES
    assert len({quantity.name for quantity in QUANTITIES}) == len(QUANTITIES)
    for quantity in QUANTITIES:
        unit, fields = rows[quantity.name]
        assert unit == (quantity.unit or "1")
        mine = {field.removesuffix(".total") for field, known in FIELDS.items() if known is quantity}
        assert fields & mine, quantity
        assert not fields - mine, quantity


def test_the_tables_and_plots_of_a_run_and_of_a_recording_use_the_names(runs: dict[str, Path]) -> None:
    summary: dict[str, Any] = json.loads((runs["mfgfl-hf"] / "summary.json").read_text())
    console = Console(file=io.StringIO(), width=200)
    console.print(summary_table(summary, None))
    table = console.file.getvalue()
    for field in ("t_avg_s", "energy_mean_J", "phi_A", "phi_C_distinct", "collisions", "distance_mean_m", "outages"):
        assert f"│ {FIELDS[field].name}" in table
    assert re.search(r"alignment φ_A +│ +[\d.]+ │ m/s, lower is better", table)
    panels = list(titles(plot_run(runs["mfgfl-hf"])["curves"]))
    for quantity in (quantities.ENERGY, quantities.SPEED, quantities.HJB_RESIDUAL, quantities.FPK_RESIDUAL):
        assert any(panel.startswith(quantity.name) for panel in panels), quantity
    assert "alignment φ_A, lower is better" in panels
    for plot, quantity in (
        (plots.BITS, quantities.PAYLOAD),
        (plots.RISK, quantities.RISK_PRINTED),
        (plots.FAILURES, quantities.OUTAGES),
        (plots.FAILURES, quantities.COLLISIONS),
        *((plots.diagnostic(name), FIELDS[name]) for name in DIAGNOSTICS),
    ):
        assert quantity.name in plot.title
    assert plots.ALIGNMENT.title == "alignment φ_A, m/s, lower is better"
    for field, title in CRITERIA:
        assert title == FIELDS[field].remarked


@pytest.fixture
def of_a_stranger(runs: dict[str, Path], tmp_path: Path) -> Path:
    """A run of a controller that is not installed here, with a diagnostic of its own, and clusters in its rounds."""
    folder = tmp_path / "run"
    shutil.copytree(runs["hjb"], folder)
    scenario = (folder / "scenario.toml").read_text().replace('method = "hjb"', 'method = "nobody-has-it"')
    (folder / "scenario.toml").write_text(scenario.replace("clusters = 1", "clusters = 3"))
    rows = pq.read_table(folder / "timeseries.parquet")
    renamed = {"hjb_residual": "tension"}
    pq.write_table(rows.rename_columns([renamed.get(name, name) for name in rows.column_names]), folder / TIMESERIES)
    return folder


def test_a_run_is_plotted_where_its_controller_is_not_installed(of_a_stranger: Path) -> None:
    figures = plot_run(of_a_stranger)
    panels = titles(figures["curves"])
    assert tuple(panels) == (
        "energy, past arrival too: mean, max, min",
        "speed: mean, max, min",
        "payload",
        "alignment φ_A, lower is better",
        "collision risk φ_C",
        "tension: mean, max, min",
        "interaction term φ_G: mean, max, min",
        "spread of the models",
    )
    assert plain(figures["curves"].get_supxlabel()) == "zero throughout the flight: arrived; collisions"
    assert panels["tension: mean, max, min"].get_ylabel() == "tension"
    (mean,) = panels["tension: mean, max, min"].lines
    reported = np.isfinite(np.asarray(mean.get_ydata(), dtype=float))
    assert reported[1:].all()
    assert not reported[0]  # at take-off nothing was reported yet
    assert plain(figures["paths"].axes[0].get_title(loc="left")).startswith("nobody-has-it, seed 1: ")
    assert len(figures["paths"].axes) == 2  # φ_G is there, whoever reports it
    rows = pq.read_table(of_a_stranger / TIMESERIES).drop_columns(["phi_G"])
    assert block_of(rows.slice(0, 5), 0).diagnostic_names == ("tension",)
    assert Reported.within(rows) == (("tension",), 246)


def test_a_run_without_its_scenario_is_plotted_with_all_its_uavs(of_a_stranger: Path) -> None:
    uavs, panels = len(plot_run(of_a_stranger)["paths"].axes[0].collections), titles(plot_run(of_a_stranger)["curves"])
    (of_a_stranger / "scenario.toml").unlink()
    figures = plot_run(of_a_stranger)
    assert (len(figures["paths"].axes[0].collections), titles(figures["curves"]).keys()) == (uavs, panels.keys())


def test_a_lost_uav_has_no_part_in_the_mean_of_a_diagnostic(of_a_stranger: Path) -> None:
    rows = pq.read_table(of_a_stranger / TIMESERIES)
    uavs = len(rows["x_m"][0])
    status = np.zeros((len(rows), uavs), np.uint8)
    status[3:, 0], status[-1] = Status.LOST, Status.LOST  # one from the fourth row on, in the last all
    tension = np.where(status == Status.LOST, 0.0, 5.0)
    for name, values in (("status", status), ("tension", tension)):
        place = rows.column_names.index(name)
        rows = rows.set_column(place, name, pa.array(values.tolist(), rows.schema.field(name).type))
    pq.write_table(rows, of_a_stranger / TIMESERIES)
    (mean,) = titles(plot_run(of_a_stranger)["curves"])["tension: mean, max, min"].lines
    np.testing.assert_array_equal(mean.get_ydata(), [np.nan] + [5.0] * (len(rows) - 2) + [np.nan])
    block = block_of(rows, 0)
    fields = (block.states, block.diagnostics, block.swarm, block.energy, block.status, block.diagnostic_names)
    sent = plot_rows(np.arange(len(rows)), *fields)
    (ticks,) = [ticks for entity, ticks, _ in sent if entity == plots.diagnostic("tension").entity]
    assert list(ticks) == list(range(1, len(rows) - 1))


def test_methods_of_one_figure_differ_in_colour_and_marker() -> None:
    looks = plotstyle.looks(["plan", "orca", "hjb", "cruise", "lqr", "vasarhelyi", "rls"])
    assert len({each.colour for each in looks.values()}) == len({each.marker for each in looks.values()}) == len(looks)
    assert (looks["hjb"], looks["plan"]) == (plotstyle.look("hjb"), plotstyle.look("plan"))


@pytest.mark.parametrize("ends", [(0.00095, 0.0027), (0.0003, 0.004), (0.01, 3.0)])
def test_a_logarithmic_axis_has_two_numbers_at_least(ends: tuple[float, float]) -> None:
    ax = plotstyle.figure(3.0, 2.0).subplots()
    ax.plot(ends)
    plotstyle.log_axis(ax)
    low, high = ax.get_ylim()
    assert sum(low <= tick <= high for tick in ax.yaxis.get_majorticklocs()) >= 2


VALUES = np.random.default_rng(1).normal(3.0, 2.0, 9)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (statistics.mean(VALUES), stats.t.interval(0.95, 8, VALUES.mean(), stats.sem(VALUES))),
        (statistics.share([False] * 10), stats.binomtest(0, 10).proportion_ci(0.95, "exact")),
        (statistics.share([True] * 3 + [False] * 7), stats.binomtest(3, 10).proportion_ci(0.95, "exact")),
        (statistics.share([True] * 10), stats.binomtest(10, 10).proportion_ci(0.95, "exact")),
        (statistics.rate([0] * 20), (0.0, -math.log(0.025) / 20)),
        (statistics.rate([0, 2, 1]), (stats.chi2.ppf(0.025, 6) / 6, stats.chi2.ppf(0.975, 8) / 6)),
    ],
)
def test_an_interval_is_students_or_the_exact_one(found: statistics.Estimate, expected: tuple[float, float]) -> None:
    assert (found.low, found.high) == pytest.approx(expected)


def test_fiellers_ends_are_where_the_t_test_turns() -> None:
    draw = np.random.default_rng(2)
    b = draw.normal(5.0, 1.0, 12)
    a = 0.7 * b + draw.normal(0.0, 0.5, 12)
    estimate = statistics.ratio(a, b)
    for end in (estimate.low, estimate.high):
        assert stats.ttest_1samp(a - end * b, 0.0).pvalue == pytest.approx(0.05)
    assert estimate.low < a.mean() / b.mean() < estimate.high
    assert not statistics.ratio([1.0, 2.0, 3.0], [-1.0, 1.0, 0.5]).bounded  # the divisor may be 0


def test_missing_values_leave_their_pair() -> None:
    estimate = statistics.difference([1.0, math.nan, 3.0, 4.0], [0.0, 1.0, math.nan, 2.0])
    assert (estimate.value, estimate.n) == (1.5, 2)


def test_a_run_is_plotted_with_the_same_bytes_under_any_matplotlibrc(runs: dict[str, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(runs["mfgfl-hf"], tmp_path / "run"))
    with (folder / "events.jsonl").open("a") as events:
        events.write('{"tick": 3, "kind": "coll')  # the last line was cut off
    figures = plot_run(folder)
    assert set(figures) == {"paths", "curves"}
    assert all(map(every_axis, figures.values()))
    ours = plotstyle.write({"paths": figures["paths"]}, tmp_path / "ours")
    assert [path.name for path in ours] == ["paths.png", "paths.svg"]
    with mpl.rc_context({"axes.facecolor": "red", "savefig.facecolor": "red", "legend.loc": "center"}):
        theirs = plotstyle.write({"paths": plot_run(folder)["paths"]}, tmp_path / "theirs")
    assert [path.read_bytes() for path in theirs] == [path.read_bytes() for path in ours]


def test_every_column_says_what_it_is_in_the_file_itself(run: Path) -> None:
    schema = pq.read_schema(run / TIMESERIES)
    described = quantities.columns(diagnostics_in(schema))
    assert schema.names == [column.key for column in described]
    for column in described:
        told = {key.decode(): value.decode() for key, value in schema.field(column.key).metadata.items()}
        assert told["description"] == column.about
        assert told["unit"] == column.unit
        assert told["cumulative"] == ("true" if column.cumulative else "false")
    assert schema.types == schema_of(diagnostics_in(schema)).types
    assert [str(schema.field(name).type) for name in ("tick", "x_m", "energy_J", "status", "phi_A")] == [
        "int32", "list<element: double>", "list<element: float>", "list<element: uint8>", "double",
    ]  # fmt: skip
    values = schema.field("status").metadata[b"values"].decode()
    assert values == ", ".join(f"{status.value} {status.name.lower()}" for status in Status)
    rows = pq.read_table(run / TIMESERIES)
    for column in described:  # a count that is cumulative never falls; means may
        if column.cumulative and not column.key.startswith("phi_"):
            assert (np.diff(np.array(rows[column.key].to_pylist()), axis=0) >= 0).all(), column.key


def flat(record: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in record.items():
        if isinstance(value, dict) and (
            value or prefix + key in ("diagnostics", "diagnostics_mean", "diagnostics_max", "dropped_messages")
        ):
            yield from flat(value, f"{prefix}{key}.") if value else [f"{prefix}{key}.*"]
        else:
            yield prefix + key


def test_every_field_of_the_summary_is_described_and_every_described_field_is_there(run: Path) -> None:
    summary = json.loads((run / SUMMARY).read_text())
    known = {field.key for field in quantities.SUMMARY}
    assert len(known) == len(quantities.SUMMARY)
    found = {key: next((name for name in sorted(known) if fnmatchcase(key, name)), None) for key in flat(summary)}
    assert not [key for key, entry in found.items() if entry is None]
    absent = set()
    for table in ("realtime", "steered", "until", "groups"):
        absent |= {key for key in known if key.startswith(f"{table}.")} if summary[table] is None else {table}
    assert known - set(found.values()) == absent


def test_the_mean_of_a_diagnostic_is_over_the_ticks_and_uavs_on_the_way(runs: dict[str, Path]) -> None:
    summary = json.loads((runs["hjb"] / SUMMARY).read_text())
    rows = pq.read_table(runs["hjb"] / TIMESERIES)
    for name in ("hjb_residual", "phi_G"):
        values = np.array(rows[name].to_pylist())[1:]  # all UAVs are on the way in all ticks
        assert summary["diagnostics_mean"][name] == pytest.approx(values.mean(), rel=1e-6)
        assert summary["diagnostics"][name] == pytest.approx(values.sum(), rel=1e-6)


def test_every_kind_of_event_is_described(run: Path) -> None:
    told = [json.loads(line) for line in (run / EVENTS).read_text().splitlines()]
    assert {"joined", "fault", "lost", "finished"} <= {event["kind"] for event in told} <= set(KINDS)
    assert all(set(event) == set(event_log.FIELDS) for event in told)
    assert all(event_log.row_of(event_log.event_of_row(event), 0.1) == event for event in told)


def test_a_kind_has_one_level_and_every_type_a_kind_but_those_of_earlier_runs() -> None:
    assert all(each.meanings for each in TYPES.values() if each is not Untyped)
    assert all(LEVELS[kind] == each.level for each in TYPES.values() for kind in each.meanings)


def test_an_event_of_a_run_of_1_0_is_read_without_fields() -> None:
    line = {"tick": 3, "sim_time_s": 0.3, "kind": "hit", "text": "UAV 2 hit obstacle 0", "uavs": [2]}
    event = event_log.event_of_row(line)
    assert (event.kind, event.text, event.uavs) == ("hit", "UAV 2 hit obstacle 0", (2,))
    assert event_log.event_level(event) == "ERROR"


def test_a_block_with_a_diagnostic_called_as_a_column_is_rejected() -> None:
    (block,) = flight(uavs=2, ticks=20)
    inbound.check(block, 2)
    for names in (("status", "b", "c"), ("b", "b", "c"), ("not a name", "b", "c")):
        with pytest.raises(MessageRejected, match="diagnostics"):
            inbound.check(msgspec.structs.replace(block, diagnostic_names=names), 2)
