"""Groups of UAVs in files, recordings, plots, exports, tables and metrics."""

import csv
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from mcap.reader import make_reader
from msgspec.structs import replace
from rosbags.typesys import Stores, get_typestore

from meanflock.cli.command import main
from meanflock.launch.engine import Engine
from meanflock.launch.options import FlightOptions
from meanflock.launch.run import fly
from meanflock.net.exporter import Exporter
from meanflock.recording import drawing, plots
from meanflock.recording import recorder as recording
from meanflock.recording.replay import complete
from meanflock.results import inbound
from meanflock.results.flown import flown_keys
from meanflock.results.groups import run_name, uav_names
from meanflock.results.plots import plotstyle
from meanflock.results.plots.curves import plot_curves
from meanflock.results.plots.run import plot_paths, plot_run, stored
from meanflock.results.plots.thumbnail import thumbnail
from meanflock.results.run_folder import to_toml
from meanflock.results.scenario_keys import changed_keys, flat, flown_mission
from meanflock.results.series import block_of, per_uav, rows_of
from meanflock.results.summary_file import read_summary
from meanflock.swarm import mission
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import Status
from tests.groundstation.conftest import plain, titles
from tests.groundstation.recordings import column, fixed, scalars

ORCA = {"name": "couriers", "count": 3, "method": "orca"}
GROUPS = [
    {"name": "learners", "count": 4, "method": "mfgfl-hf"},
    ORCA | {"start": {"formation": "circle", "centre": [-60.0, 60.0], "radius": 20.0}},
    {"name": "reserve", "count": 2, "joins_at_s": 5.0, "leaves_at_s": 10.0},
]
LEARNERS, COURIERS, RESERVE = slice(0, 4), slice(4, 7), slice(7, 9)
DIMMED = int(drawing.dimmed(np.array([drawing.group_color(2)], dtype=np.uint32))[0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    flown = load(None, uavs=9, duration=14.0, groups=GROUPS, stop="duration")
    options = FlightOptions(out=tmp_path_factory.mktemp("runs"), in_process=True, record=True, quiet=True)
    return fly(flown, options).folder


@pytest.fixture(scope="module")
def rows(folder: Path) -> Any:
    return pq.read_table(folder / "timeseries.parquet")


# -- files ---------------------------------------------------------------------------------------------------------


def test_a_diagnostic_that_a_uav_does_not_have_is_null(folder: Path, rows: Any, tmp_path: Path) -> None:
    for tick in (0, 60, -1):
        unknown = [value is None for value in rows["phi_G"][tick].as_py()]
        assert unknown == [False] * 4 + [True] * 3 + [False] * 2
        assert None not in rows["energy_J"][tick].as_py()
    assert main(["plot", str(folder), "--csv", str(tmp_path / "rows.csv")]) == 0
    with (tmp_path / "rows.csv").open() as file:
        assert [row["phi_G"] == "" for row in csv.DictReader(file)][:9] == unknown


def test_rows_are_read_back_as_the_telemetry_that_they_were(rows: Any) -> None:
    block = inbound.check(block_of(rows, 0), 9)  # what is missing is 0, as in messages
    assert block.has_diagnostic is not None
    assert block.has_diagnostic[:, block.diagnostic_names.index("phi_G")].tolist() == [1] * 4 + [0] * 3 + [1] * 2
    again = rows_of(block, 0.1)
    assert all(again[name].equals(rows[name].combine_chunks()) for name in block.diagnostic_names)


def test_the_summary_of_groups_is_read_and_so_is_one_without(folder: Path, tmp_path: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    assert read_summary(folder / "summary.json") == summary
    (tmp_path / "summary.json").write_text(json.dumps(summary | {"groups": None}))
    assert read_summary(tmp_path / "summary.json")["groups"] is None


def test_names_are_those_of_the_groups(folder: Path) -> None:
    flown = flown_keys(folder)
    assert mission.method(flown) == "mfgfl-hf+orca"
    assert (run_name(flown), run_name(flown, "mine")) == ("groups-s1", "mine-s1")
    assert run_name(load(None, uavs=3, groups=[ORCA]), "mine") == "orca-s1"
    assert uav_names(flown)[3:5] == ["UAV 3, learners", "UAV 4, couriers"]
    assert uav_names(Scenario(uavs=2)) == ["UAV 0", "UAV 1"]


# -- recordings ----------------------------------------------------------------------------------------------------


def check_recording(path: Path, rows: Any) -> None:
    ticks, colors = column(path, "map/uavs", "Points2D:colors")
    at = dict(zip(ticks.tolist(), colors, strict=True))
    colours = [drawing.group_color(number) for number in (0, 0, 0, 0, 1, 1, 1, 2, 2)]
    assert at[20] == [*colours[:7], DIMMED, DIMMED]  # the reserve waits
    assert at[80] == colours
    assert at[130] == [*colours[:7], DIMMED, DIMMED]  # it has landed
    ticks, lanes = column(path, "UAVs", "StateChange:state")
    assert [row[8] for row in lanes] == [f"UAV 8, reserve: {now}" for now in ("waiting", "flying", "landed")]
    assert ticks.tolist() == [0, 50, 101]
    assert fixed(path, "map/uavs", "Points2D:labels")[4] == "UAV 4, couriers"
    assert fixed(path, "map/legend/groups/couriers", "LineStrips2D:colors") == [drawing.group_color(1)]
    ticks, lines = scalars(path, plots.ENERGY)
    energy, uavs = per_uav(rows, "energy_J")[..., 0], (LEARNERS, COURIERS, RESERVE)
    np.testing.assert_array_equal(ticks, rows["tick"].to_numpy())
    np.testing.assert_allclose(lines, np.stack([energy[:, own].mean(axis=1) for own in uavs], axis=-1), rtol=1e-6)
    velocity = per_uav(rows, "vx_m_s", "vy_m_s")
    speed = [np.linalg.norm(velocity[:, own], axis=-1).mean(axis=1) for own in uavs]
    np.testing.assert_allclose(scalars(path, plots.SPEED)[1], np.stack(speed, axis=-1), rtol=1e-6)
    assert not scalars(path, plots.ARRIVED)[1].any()
    for plot in (plots.ENERGY, plots.SPEED, plots.ARRIVED):
        assert fixed(path, plot.entity, "SeriesLines:names") == [group["name"] for group in GROUPS]
        assert fixed(path, plot.entity, "SeriesLines:colors") == list(map(drawing.group_color, range(3)))
    ticks, lines = scalars(path, plots.diagnostic("phi_G"))
    values = per_uav(rows, "phi_G")[..., 0]
    for tick, has in ((30, [0, 1, 2, 3]), (80, [0, 1, 2, 3, 7, 8]), (130, [0, 1, 2, 3])):
        (line,) = lines[ticks == tick]
        own = values[tick, has]
        np.testing.assert_allclose(line, [own.mean(), own.min(), own.max()], rtol=1e-6)


def test_a_recording_has_the_colours_and_names_of_groups_and_means_of_the_uavs_that_have_a_number(
    folder: Path, rows: Any
) -> None:
    check_recording(folder / "recording.rrd", rows)


def test_a_recording_counts_the_arrived_uavs_in_the_air_by_group(rows: Any) -> None:
    block = block_of(rows, 0)
    status = np.zeros_like(block.status)
    status[50:, 0], status[60:, 4:6], status[90:, 4] = Status.ARRIVED, Status.ARRIVED, Status.LANDED
    ticks, fields = np.arange(len(status)), (block.states, block.diagnostics, block.swarm, block.energy)
    sent = plots.plot_rows(ticks, *fields, status, block.diagnostic_names, groups=[LEARNERS, COURIERS, RESERVE])
    ((values,),) = [columns for entity, _, columns in sent if entity == plots.ARRIVED.entity]
    counts = np.array(values.as_arrow_array().to_pylist())
    assert [counts[at].tolist() for at in (0, 50, 60, 90)] == [[0, 0, 0], [1, 0, 0], [1, 2, 0], [1, 1, 0]]


def test_views_have_a_line_a_group_where_there_are_groups() -> None:
    flown = load(None, uavs=9, duration=14.0, groups=GROUPS)
    titles = [plot.title for plot in plots.of_flight(flown)]
    assert titles[:2] == ["energy, past arrival too, J: mean of each group", "speed, m/s: mean of each group"]
    assert titles[-1] == plots.ARRIVED.title
    assert plots.of_flight(Scenario()) == plots.OF_EVERY_FLIGHT


def test_a_recording_that_is_made_of_the_time_series_is_the_same(folder: Path, rows: Any) -> None:
    recorded = (folder / "recording.rrd").read_bytes()
    try:
        (folder / "recording.rrd").unlink()
        complete(folder)
        check_recording(folder / "recording.rrd", rows)
    finally:
        (folder / "recording.rrd").write_bytes(recorded)


def test_there_are_more_groups_than_colours(tmp_path: Path) -> None:
    groups = [{"name": f"g{number}", "count": 1, "method": "cruise"} for number in range(8)]
    flown = load(None, uavs=8, duration=1.0, groups=groups)
    with recording.Recorder(flown, "many", tmp_path / "many.rrd") as recorder:
        engine = Engine(flown, "many", sinks=[recorder])
        engine.complete()
    (_, colors) = column(tmp_path / "many.rrd", "map/uavs", "Points2D:colors")
    assert colors[0][6:] == colors[0][:2]


# -- plots and exports ---------------------------------------------------------------------------------------------


def test_plots_have_a_colour_a_group_and_a_legend(folder: Path) -> None:
    figures = plot_run(folder)
    for figure in figures.values():
        (legend,) = figure.legends
        shown = {text.get_text(): line for text, line in zip(legend.get_texts(), legend.get_lines(), strict=True)}
        for number, group in enumerate(GROUPS):
            assert to_hex(shown[group["name"]].get_color()).upper() == plotstyle.group_colour(number)
    assert figures["paths"].axes[0].get_title(loc="left").startswith("mfgfl-hf+orca, seed 1")
    names = [str(text.get_text()) for text in figures["paths"].legends[0].get_texts()]
    assert names[-1] == "goal, 5 m"  # of all groups
    drawing = thumbnail(stored(folder))
    assert all(f'stroke="{plotstyle.group_colour(number)}"' in drawing for number in range(3))
    assert all(
        f'fill="{plotstyle.group_colour(number)}">{group["name"]}<' in drawing for number, group in enumerate(GROUPS)
    )


def test_curves_have_a_line_a_group_and_leave_out_what_is_zero_throughout(folder: Path, rows: Any) -> None:
    figure = plot_run(folder)["curves"]
    panels = titles(figure)
    names = ("HJB residual |e_H|: mean", "FPK residual |e_F|: mean", "interaction term φ_G: mean, max, min")
    assert tuple(panels)[4:] == ("collision risk φ_C", *names, "spread of the models")
    assert [plain(ax.get_ylabel()) for ax in panels.values()][:4] == [
        "energy (J)",
        "speed (m/s)",
        "payload (bits)",
        "φ_A (m/s)",
    ]
    zero = "arrived; collisions; no feasible command; own state not sent"
    assert plain(figure.get_supxlabel()) == f"zero throughout the flight: {zero}"
    energy = per_uav(rows, "energy_J")[..., 0]
    lines = panels["energy, past arrival too: mean, max, min"].lines
    for number, (line, own) in enumerate(zip(lines, (LEARNERS, COURIERS, RESERVE), strict=True)):
        np.testing.assert_allclose(line.get_ydata(), energy[:, own].mean(axis=1))
        assert to_hex(line.get_color()).upper() == plotstyle.group_colour(number)
    assert [line.get_color() for line in panels["payload"].lines] == [plotstyle.INK]
    assert figure.legends[0].get_texts()[-1].get_text() == "all UAVs"


def test_groups_beyond_the_colours_have_other_dashes_in_plots_and_their_legends(tmp_path: Path) -> None:
    groups = [{"name": f"g{number}", "count": 1, "method": "cruise"} for number in range(14)]
    options = FlightOptions(out=tmp_path, in_process=True, record=False, quiet=True)
    run = stored(fly(load(None, uavs=14, duration=1.0, groups=groups), options).folder)
    curves, paths = plot_curves(run), plot_paths(run)
    drawn = [collection for collection in paths.axes[0].collections if isinstance(collection, LineCollection)]
    energy = titles(curves)["energy, past arrival too: mean, max, min"].lines
    for looks in (
        [(to_hex(each.get_color()[0]), str(each.get_linestyle())) for each in drawn],
        [(to_hex(line.get_color()), str(line._dash_pattern)) for line in energy],
        *(
            [(to_hex(line.get_color()), str(line._dash_pattern)) for line in figure.legends[0].get_lines()[:14]]
            for figure in (curves, paths)
        ),
    ):
        assert len(looks) == len({*looks}) == 14
        assert len({dash for _, dash in looks[:6]}) == 1
    assert len(drawn[0].get_segments()[0]) == run.table.num_rows  # a dash is longer than the way of a tick


def test_a_quantity_that_is_zero_throughout_is_named_without_its_remark(folder: Path) -> None:
    run = stored(folder)
    place, still = run.table.column_names.index("phi_A"), pa.array(np.zeros(run.table.num_rows))
    figure = plot_curves(run._replace(table=run.table.set_column(place, "phi_A", still)))
    assert plain(figure.get_supxlabel()).startswith("zero throughout the flight: alignment φ_A; arrived; collisions; ")


def test_the_title_of_paths_has_the_lost_uavs_and_the_time_with_its_digits(folder: Path) -> None:
    run = stored(folder)
    status = run.grid("status").astype(np.uint8)
    status[1:, [0, 4]] = Status.LOST
    place = run.table.column_names.index("status")
    column = pa.array(status.tolist(), run.table.schema.field("status").type)
    lost = run.table.set_column(place, "status", column)
    shown = [
        plot_paths(run._replace(table=table)).axes[0].get_title(loc="left").split(": ")[-1].replace("\n", " ")
        for table in (run.table, lost, lost[:2])
    ]
    assert shown == [
        "0 of 9 arrived in 14 s",
        "0 of 9 arrived in 14 s, 2 lost",
        "0 of 9 arrived in 0.1 s, 2 lost",
    ]


def test_long_names_of_groups_fit_into_the_figures(folder: Path) -> None:
    run = stored(folder)
    named = [replace(group, name=f"{group.name}-{'and-so-on-' * 3}") for group in run.scenario.groups]
    run = run._replace(scenario=replace(run.scenario, groups=tuple(named)))
    for figure in (plot_curves(run), plot_paths(run)):
        figure.draw_without_rendering()
        box, panels = figure.legends[0].get_window_extent(), [ax.get_tightbbox() for ax in figure.axes]
        assert 0.0 <= box.x0 < box.x1 <= figure.bbox.width
        assert not any(box.overlaps(panel) for panel in panels if panel is not None)


def test_arrivals_are_counted_by_group_and_stay_counted_after_the_landing(folder: Path) -> None:
    run = stored(folder)
    status = run.grid("status").astype(np.uint8)
    status[100:, 5], status[120:, 5] = Status.ARRIVED, Status.LANDED
    place = run.table.column_names.index("status")
    column = pa.array(status.tolist(), run.table.schema.field("status").type)
    arrived = pa.array((np.arange(len(status)) >= 100).astype(np.int64), run.table.schema.field("arrived").type)
    table = run.table.set_column(place, "status", column)
    table = table.set_column(table.column_names.index("arrived"), "arrived", arrived)
    learners, couriers, reserve = titles(plot_curves(run._replace(table=table)))["arrived"].lines
    assert couriers.get_ydata().tolist() == [0] * 100 + [1] * (len(status) - 100)
    assert not np.any([learners.get_ydata(), reserve.get_ydata()])


def test_an_export_has_groups_as_namespaces_and_the_status_of_uavs_that_landed(folder: Path, tmp_path: Path) -> None:
    assert main(["export", str(folder), "--mcap", str(tmp_path / "out.mcap"), "--quiet"]) == 0
    store = get_typestore(Stores.ROS2_KILTED)
    with (tmp_path / "out.mcap").open("rb") as file:
        last = {
            channel.topic: (schema.name, found.data) for schema, channel, found in make_reader(file).iter_messages()
        }
    read = {topic: store.deserialize_cdr(last[topic][1], last[topic][0]) for topic in ("/uavs", "/diagnostics")}
    arrows, labels = read["/uavs"].markers[::2], read["/uavs"].markers[1::2]
    assert [marker.ns for marker in arrows] == ["learners"] * 4 + ["couriers"] * 3 + ["reserve"] * 2
    assert [label.text for label in labels[6:]] == ["6", "7 landed", "8 landed"]
    courier, reserve = read["/diagnostics"].status[1 + 4], read["/diagnostics"].status[1 + 7]
    assert reserve.message == "landed"
    assert {pair.key: pair.value for pair in courier.values}.items() >= {"group": "couriers", "phi_G": ""}.items()


# -- tables and metrics --------------------------------------------------------------------------------------------


@pytest.fixture
def shown(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["show", str(folder)]) == 0
    return capsys.readouterr().out


def test_show_has_a_row_a_group_in_80_columns(shown: str) -> None:
    lines = shown.splitlines()
    assert max(map(len, lines)) <= 80
    groups = lines[lines.index("Groups") :]
    head = next(place for place, line in enumerate(groups) if line.startswith("group "))
    assert groups[head].split()[:5] == ["group", "method", "UAVs", "arrived", "landed"]
    assert "travel until" in " ".join(" ".join(groups[:head]).split())
    assert "Travel time: mean of the UAVs that arrived." in " ".join(groups)
    assert [line.split()[:5] for line in groups[head + 2 : head + 5]] == [
        ["learners", "mfgfl-hf", "4", "0", "0"],
        ["couriers", "orca", "3", "0", "0"],
        ["reserve", "mfgfl-hf", "2", "0", "2"],
    ]
    assert "2 landed for good." in " ".join(lines[:6])


def test_metrics_count_uavs_by_status_and_group() -> None:
    flown = load(None, uavs=9, duration=14.0, groups=GROUPS)
    engine = Engine(flown, "watched")
    engine.complete()
    families = {
        family.name: family for family in Exporter(engine.world, "watched", "in-process", engine.watch).collect()
    }
    counts = {
        (sample.labels["group"], sample.labels["status"]): sample.value for sample in families["meanflock_uavs"].samples
    }
    assert counts["reserve", "landed"] == 2.0
    assert sum(counts.values()) == 9.0
    assert {status for _, status in counts} == {status.name.lower() for status in Status}
    (sample,) = families["meanflock_run"].samples
    assert sample.labels["method"] == "mfgfl-hf+orca"


# -- keys of one group ---------------------------------------------------------------------------------------------


def test_a_key_of_one_group_is_set_by_its_name() -> None:
    flown = load(Path("groups"), ["groups.couriers.method=bvc", "groups.reserve.joins_at_s=30"])
    assert [group.method for group in flown.groups] == [None, "bvc", None]
    assert flown.replace(**{"groups.reserve.joins_at_s": 40.0}).groups[2].joins_at_s == 40.0
    assert flown.groups[2].joins_at_s == 30.0


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("groups.courier.method=bvc", "none is called 'courier'.*couriers.*there are learners, couriers, reserve"),
        ("groups.method=bvc", "`groups` are several tables; write groups.NAME.KEY"),
    ],
)
def test_a_key_of_no_group_is_refused(setting: str, says: str) -> None:
    with pytest.raises(BadInput, match=says):
        load(Path("groups"), [setting])


def test_keys_of_groups_differ_one_by_one_from_the_defaults_and_from_those_of_another_flight() -> None:
    def keys(*settings: str) -> dict[str, Any]:
        return flat(tomllib.loads(to_toml(load(Path("groups"), settings))))

    flown = keys("groups.couriers.method=bvc")
    changed = changed_keys(flown)
    assert changed["groups"] == (["learners", "couriers", "reserve"], [])
    assert changed["groups.couriers.method"] == ("bvc", "mfgfl-hf")  # of the flight
    assert changed["groups.couriers.start.radius"] == (60.0, 25.0)
    assert changed["groups.learners.count"] == (12, None)
    assert "groups.couriers.destination.patrol" not in changed  # set, to what the flight has
    slow = ["controller.speed_m_s=4", "groups.couriers.controller.speed_m_s=4", "groups.reserve.controller.speed_m_s=4"]
    mixed = changed_keys(keys("method=bvc", "groups.learners.method=mfgfl-hf", *slow))
    assert mixed["groups.learners.method"] == ("mfgfl-hf", "bvc")
    assert mixed["groups.couriers.controller.speed_m_s"] == (4, None)  # of another controller than the flight's
    assert "groups.reserve.controller.speed_m_s" not in mixed
    later = keys("groups.couriers.method=bvc", "groups.reserve.joins_at_s=30")
    assert changed_keys(flown, later) == {"groups.reserve.joins_at_s": (20.0, 30.0)}
    assert flown_mission(later, None) == (
        "groups",
        {"groups.couriers.method": "bvc", "groups.reserve.joins_at_s": 30.0},
    )
    assert str(flown_mission(later, None)) == "groups +2"
    own = [{"name": "a", "count": 9}, {"name": "b", "count": 16, "method": "bvc", "joins_at_s": 2.0}]
    other = flat(tomllib.loads(to_toml(Scenario(duration=9.0, groups=own))))
    assert str(flown_mission(other, None)) == "paper +1, 2 groups"
