"""The recorder: a recording has the numbers of the telemetry; its map has faults, goals, discs, wind and hits."""

import socket
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import msgspec
import numpy as np
import pytest
from rerun.chunk import RrdReader

import meanflock as mf
from meanflock.recording import blueprint as look
from meanflock.recording import drawing, mission_map, plots
from meanflock.recording.recorder import Recorder
from meanflock.recording.replay import verify
from meanflock.results.plots.run import plot_run
from meanflock.results.series import Reported
from meanflock.swarm import state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.events import RoundEnded, UploadsRefused
from meanflock.swarm.faults import Fault, Gust, Jam, Kill, Partition, Pause
from meanflock.swarm.mission import goals, obstacles, starts
from meanflock.swarm.scenario import Federation, Scenario, load
from meanflock.swarm.wire.messages import SWARM_COLUMNS, FrameKind, Status, Telemetry
from meanflock.worldsim.vehicles.base import MeanWind
from tests.groundstation.recordings import (
    COLLISIONS,
    HJB,
    ROUND_TICKS,
    WEIGHTS,
    column,
    fixed,
    flight,
    record,
    rows,
    scalars,
)

pytestmark = pytest.mark.usefixtures("strict")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Telemetry], np.ndarray]:
    """A recording, the telemetry and its states, (T, N, 4)."""
    path = tmp_path_factory.mktemp("recording") / "recording.rrd"
    blocks = flight()
    record(path, blocks)
    return path, blocks, np.concatenate([block.states for block in blocks])


def test_positions_velocities_trails_and_the_leaders_frame_are_the_telemetrys(recorded) -> None:
    path, _, states = recorded
    assert verify(path) is None
    assert len(RrdReader(path).blueprints()) == 1
    for chunk in RrdReader(path).stream().filter(content=f"/{look.UAVS}"):
        batch = chunk.to_record_batch()
        if look.TIMELINE in batch.schema.names:
            nanoseconds = batch.column(look.TIMELINE).cast("int64").to_numpy()
            np.testing.assert_allclose(nanoseconds, batch.column(look.TICKS).to_numpy() * 0.1e9, atol=1)
    ticks, positions = column(path, look.UAVS, "Points2D:positions")
    np.testing.assert_array_equal(ticks, np.arange(600))
    np.testing.assert_array_equal(np.array(positions), state.position(states).astype(np.float32))
    _, vectors = column(path, look.VELOCITY, "Arrows2D:vectors")
    np.testing.assert_allclose(np.array(vectors), state.velocity(states) * look.ARROW_S, rtol=1e-6)
    _, frames = column(path, look.LEADER, "Transform3D:translation")
    np.testing.assert_array_equal(np.array(frames)[:, 0, :2], states[:, 0, :2].astype(np.float32))
    ticks, strips = column(path, look.TRAILS, "LineStrips2D:strips")
    pieces = np.array(strips)  # (pieces, N, points, 2)
    np.testing.assert_array_equal(ticks, np.arange(5, 600, 5))
    np.testing.assert_array_equal(pieces[1:, :, 0], pieces[:-1, :, -1])
    np.testing.assert_array_equal(pieces[:, :, -1], states[ticks, :, :2].astype(np.float32))


def test_plots_hold_the_telemetrys_numbers(recorded) -> None:
    path, blocks, _ = recorded
    swarm = {name: np.concatenate([b.swarm for b in blocks])[:, i] for i, name in enumerate(SWARM_COLUMNS)}
    energy = np.concatenate([block.energy for block in blocks])
    ticks, values = scalars(path, plots.ENERGY)
    np.testing.assert_array_equal(ticks, np.arange(600))
    np.testing.assert_allclose(values, np.stack([energy.mean(1), energy.min(1), energy.max(1)], axis=-1))
    for plot, names, unit in (
        (plots.BITS, ("uplink_bits", "relay_bits", "broadcast_bits", "state_bits"), 1e6),
        (plots.ALIGNMENT, ("phi_A",), 1),
        (plots.RISK, ("phi_C", "phi_C_distinct"), 1),
        (plots.FAILURES, ("outages", "collisions"), 1),
    ):
        _, values = scalars(path, plot)
        np.testing.assert_allclose(values, np.stack([swarm[name] for name in names], axis=-1) / unit)
    sizes = np.abs(np.concatenate([block.diagnostics for block in blocks])[1:, :-1, 0].astype(np.float64))
    ticks, values = scalars(path, HJB)  # a residual that nobody computed has no logarithm
    np.testing.assert_array_equal(ticks, np.arange(1, 600))
    np.testing.assert_allclose(values, np.log10(np.stack([sizes.max(1), sizes.mean(1)], axis=-1)))
    ticks, texts = column(path, look.LANES, "StateChange:state")  # a lane changes with the status
    assert ticks.tolist() == [0, 400, 500]
    assert (texts[0][24], texts[1][7], texts[2][0]) == ("UAV 24: flying", "UAV 7: lost", "UAV 0: arrived")
    ticks, values = scalars(path, plots.WEIGHTS)
    np.testing.assert_array_equal(ticks, np.arange(0, 600, 20))
    drawn = Reported((), WEIGHTS).drawn
    assert len(drawn) == 60
    assert {0, WEIGHTS - 1} < set(drawn.tolist())
    np.testing.assert_array_equal(values, np.concatenate([b.reports for b in blocks])[:, drawn])


def test_a_collision_is_a_star_a_mark_and_a_log_line(recorded) -> None:
    path, _, states = recorded
    ticks, strips = column(path, look.COLLISIONS, "LineStrips2D:strips")
    np.testing.assert_array_equal(ticks, [tick for tick, _ in COLLISIONS])
    for (tick, pair), star in zip(COLLISIONS, strips, strict=True):
        corners = np.array(star)[0, :-1]
        np.testing.assert_allclose(corners.mean(axis=0), states[tick, pair, :2].mean(axis=0), atol=1e-3)
    hit_ticks, risks = scalars(path, plots.HITS)
    np.testing.assert_array_equal(hit_ticks, ticks)
    np.testing.assert_array_equal(risks, scalars(path, plots.RISK)[1][ticks, :1])
    _, texts = column(path, look.EVENTS, "TextLog:text")
    _, levels = column(path, look.EVENTS, "TextLog:level")
    log = [(text[0], level[0]) for text, level in zip(texts, levels, strict=True)]
    lines = [f"collision: UAV {first} and UAV {second} collided" for _, (first, second) in COLLISIONS]
    assert [line for line, level in log if level == "ERROR"] == [*lines, "silent: UAV 7 lost"]
    _, colors = column(path, look.EVENTS, "TextLog:color")
    shades = {text[0]: color for text, color in zip(texts, colors, strict=True)}
    assert shades[lines[0]] == [drawing.COLLISION]
    assert ("fault: a gust", "INFO") in log


def test_links_are_green_where_delivered_and_red_in_outage(recorded) -> None:
    path, _, states = recorded
    ticks, strips = column(path, look.MODEL_LINKS, "LineStrips2D:strips")
    _, colors = column(path, look.MODEL_LINKS, "LineStrips2D:colors")
    np.testing.assert_array_equal(ticks, np.arange(ROUND_TICKS, 600, ROUND_TICKS))
    sources = np.arange(1, 24)
    expected = np.where(sources % 5 == 0, drawing.RED, drawing.GREEN)
    for tick, ends, shown in zip(ticks, strips, colors, strict=True):
        np.testing.assert_array_equal(np.array(ends)[:, 0], states[tick, sources, :2].astype(np.float32))
        np.testing.assert_array_equal(np.array(ends)[:, 1], states[tick, [0] * 23, :2].astype(np.float32))
        np.testing.assert_array_equal(shown, expected)
    ticks, strips = column(path, look.STATE_LINKS, "LineStrips2D:strips")
    assert ticks.tolist() == [0]
    assert len(strips[0]) == 25
    _, edges = column(path, look.ROUND, "GraphEdges:edges")
    assert len(edges[-1]) == np.count_nonzero(sources % 5)


def test_stations_are_on_the_map_and_links_lead_to_them(tmp_path: Path) -> None:
    path, (block,) = tmp_path / "mast.rrd", flight(uavs=3, ticks=20)
    masts = ({"place": (10.0, 20.0, 25.0)}, {"place": (-30.0, 5.0, 1.5)})
    links = [(2, 0, 4, FrameKind.UPLOAD, 4, 1, 0), (2, 1, 3, FrameKind.UPLOAD, 4, 0, 0)]
    links += [(3, 3, 1, FrameKind.GLOBAL, 4, 1, 0)]
    ended = RoundEnded(3, 1, 0, "averaged", participants=3, sent=(0, 1), received=(0,), station=0)
    told = msgspec.structs.replace(block, links=np.array(links, dtype=np.int32), events=(ended,))
    flown = record(path, [told], stations=masts, federation=Federation(station=0))
    low, high = mission_map.box(flown)
    for number, (x, y) in enumerate(((10.0, 20.0), (-30.0, 5.0))):
        assert (low < (x, y)).all()
        assert (high > (x, y)).all()
        (outline,) = fixed(path, f"map/stations/{number}", "LineStrips2D:strips")
        np.testing.assert_allclose(np.array(outline)[:, 0].mean(), x, atol=3.0)
    assert fixed(path, "map/stations/1/label", "Points2D:labels") == ["station 1, 1.5 m up"]
    ticks, strips = column(path, look.MODEL_LINKS, "LineStrips2D:strips")
    assert ticks.tolist() == [2, 3]
    assert [ends[1] for ends in strips[0]] == [[-30.0, 5.0], [10.0, 20.0]]
    assert strips[1][0][0] == [10.0, 20.0]
    names = fixed(path, look.ROUND, "GraphNodes:node_ids")
    assert names[:5] == ["0", "1", "2", "station 0", "station 1"]
    assert fixed(path, look.ROUND, "GraphNodes:positions")[3] == [0.0, 0.0]  # where the leader averages
    _, edges = column(path, look.ROUND, "GraphEdges:edges")
    assert edges[-1] == [{"first": "0", "second": "station 1"}]
    assert not fixed(path, f"{look.LEADER}/ring", "Points2D:positions")


def test_a_round_of_clusters_is_a_tree(tmp_path: Path) -> None:
    """Five of five UAVs, headed by UAVs 0, 5 … 20; UAV 7 and the head of 10 to 14 are not heard, 17 is paused."""
    path, (block,) = tmp_path / "tree.rrd", flight(ticks=20)
    members = [uav for uav in range(25) if uav % 5 and uav != 17]
    up = [(2, uav, uav // 5 * 5, FrameKind.UPLOAD, 4, uav != 7, 0) for uav in members]
    on = [(3, head, 0, FrameKind.RELAY, 4, head != 10, 0) for head in (5, 10, 15, 20)]
    links = np.array(up + on, dtype=np.int32)
    sent = tuple(uav for uav in range(25) if uav not in (9, 17))
    received = tuple(uav for uav in sent if uav != 7)
    ended = RoundEnded(3, 1, 0, "averaged", participants=25, absent=1, sent=sent, received=received)
    events = (UploadsRefused(3, (11,)), ended)
    paused = Pause(tick=0, uavs=(17,), duration_s=1000.0)
    federation = Federation(clusters=5, fraction=1.0)
    record(path, [msgspec.structs.replace(block, links=links, events=events)], federation=federation, faults=(paused,))
    ticks, edges = column(path, look.ROUND, "GraphEdges:edges")
    _, colors = column(path, look.ROUND, "GraphNodes:colors")
    assert ticks.tolist() == [2, 3]
    assert [len(of_tick) for of_tick in edges] == [19 - 1, 19 - 1 + 4 - 1]
    assert (colors[0][9], colors[1][9], colors[1][11]) == (drawing.GREEN, drawing.GREY, drawing.VIOLET)
    assert colors[1][17] == drawing.DISC  # paused, not silent
    ticks, values = scalars(path, plots.ROUNDS)
    assert (ticks.tolist(), values.tolist()) == ([3], [[pytest.approx(2200 / 23), 0.0, 4.0]])
    expected = [drawing.WHITE, drawing.GREEN, drawing.GREEN, drawing.RED, drawing.RED]
    assert [colors[1][uav] for uav in (0, 5, 6, 7, 10)] == expected
    ticks, strips = column(path, look.MODEL_LINKS, "LineStrips2D:strips")
    assert (ticks.tolist(), [len(lines) for lines in strips]) == ([2, 3], [19, 4])


def test_a_large_swarm_is_recorded_coarsely(tmp_path: Path) -> None:
    path = tmp_path / "recording.rrd"
    record(path, flight(uavs=300, ticks=60))
    ticks, positions = column(path, look.UAVS, "Points2D:positions")
    np.testing.assert_array_equal(ticks, np.arange(0, 60, 5))
    assert len(positions[0]) == 300
    assert not len(column(path, look.LANES, "StateChange:state")[0])
    assert len(scalars(path, plots.ENERGY)[0]) == 60


def test_a_file_or_port_that_cannot_be_used_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"nowhere/recording\.rrd: No such file or directory; give"):
        Recorder(Scenario(), "test", tmp_path / "nowhere" / "recording.rrd")
    path = tmp_path / "recording.rrd"
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(BadInput, match=rf"127\.0\.0\.1:{port}: Address already in use; choose another port"):
            Recorder(Scenario(), "test", path, serve=("127.0.0.1", port))
    assert not path.exists()


def of_a_stranger(path: Path, names: tuple[str, ...], weights: int) -> list[Telemetry]:
    """Records a flight of a controller that is not installed here and reports these diagnostics and weights."""
    blocks = [
        msgspec.structs.replace(
            block,
            diagnostics=np.ascontiguousarray(block.diagnostics[..., : len(names)]),
            diagnostic_names=names,
            reports=np.ascontiguousarray(block.reports[:, :weights]),
        )
        for block in flight(uavs=4, ticks=60)
    ]
    record(path, blocks, Reported(names, weights), method="nobody-has-it")
    return blocks


def entities(path: Path) -> set[str]:
    return {str(chunk.entity_path).lstrip("/") for chunk in RrdReader(path).stream()}


def test_unknown_diagnostics_are_drawn_under_their_names(tmp_path: Path) -> None:
    path = tmp_path / "recording.rrd"
    blocks = of_a_stranger(path, ("tension", "phi_G"), 0)
    values = np.concatenate([block.diagnostics for block in blocks])[..., 0].astype(np.float64)
    plot = plots.diagnostic("tension")
    assert plot.title == "tension: mean, min, max"
    ticks, lines = scalars(path, plot)
    np.testing.assert_array_equal(ticks, np.arange(1, 60))  # at take-off nothing was reported yet
    values = values[1:]
    np.testing.assert_allclose(lines, np.stack([values.mean(1), values.min(1), values.max(1)], axis=-1))
    assert plots.diagnostic("phi_G").entity in entities(path)  # a name we know, and its look, whoever reports it
    assert not {plots.WEIGHTS, plots.SPREAD.entity, plots.diagnostic("hjb_residual").entity} & entities(path)


def test_trails_have_the_colours_of_phi_g_where_it_is_reported_else_of_speed(tmp_path: Path) -> None:
    for names, entity, ends in (
        (("hjb_residual", "phi_G"), "phi_G", ["φ_G ≤ 0.001", "≥ 1 s⁻²"]),
        (("hjb_residual",), "speed", ["speed 0", "≥ 5 m/s"]),
        ((), "speed", ["speed 0", "≥ 5 m/s"]),
    ):
        path = tmp_path / f"{len(names)}.rrd"
        blocks = of_a_stranger(path, names, 3)
        states = np.concatenate([block.states for block in blocks])
        _, colors = column(path, look.UAVS, "Points2D:colors")
        if entity == "speed":
            np.testing.assert_array_equal(colors, drawing.speed_colors(state.speed(states)))
        else:
            phi = np.concatenate([block.diagnostics for block in blocks])[..., 1]
            np.testing.assert_array_equal(colors, drawing.phi_g_colors(phi))
        said = [fixed(path, f"map/legend/{entity}/{end}", "Points2D:labels") for end in ("low", "high")]
        assert said == [[end] for end in ends]
        assert not {"map/legend/speed", "map/legend/phi_G"} - {f"map/legend/{entity}"} & entities(path)


SCRIPT: tuple[Fault, ...] = (
    Pause(tick=30, duration_s=1.0, uavs=(3, 4)),
    Partition(tick=35, duration_s=2.0, uavs=(5,)),
    Jam(tick=50, duration_s=1.0, centre=(120.0, 80.0), radius_m=7.0),
    Jam(tick=55, duration_s=1.0, uavs=(1, 2, 6)),
    Gust(tick=70, duration_s=0.5, acceleration=(0.5, -0.5), uavs=(8,)),
    Kill(tick=90, uavs=(5,)),
)


@pytest.fixture(scope="module")
def disturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """A recording under the script, and where the UAVs are, (T, N, 2)."""
    path, blocks = tmp_path_factory.mktemp("recording") / "recording.rrd", flight(ticks=120)
    record(path, blocks, faults=SCRIPT)
    return path, np.concatenate([block.states for block in blocks])[..., :2].astype(np.float32)


def test_marks_of_faults_come_and_go(disturbed: tuple[Path, np.ndarray]) -> None:
    path, points = disturbed
    halos = rows(path, look.HALOS, "Points2D:positions")
    for tick, uavs in ((0, []), (30, [3, 4]), (36, [5, 3, 4]), (54, [5]), (55, []), (75, [])):
        np.testing.assert_array_equal(np.reshape(halos[tick], (-1, 2)), points[tick, uavs])
    assert rows(path, look.HALOS, "Points2D:colors")[36] == [drawing.CUT, drawing.FROZEN, drawing.FROZEN]
    areas = rows(path, look.AREAS, "LineStrips2D:strips")
    ((circle),) = areas[50]
    np.testing.assert_allclose(np.hypot(*(np.array(circle) - (120.0, 80.0)).T), 7.0, rtol=1e-5)
    lines = rows(path, look.JAMS, "LineStrips2D:strips")  # between all UAVs of a jam
    np.testing.assert_array_equal(lines[55], points[55][[[1, 2], [1, 6], [2, 6]]])
    vectors, origins = rows(path, look.GUSTS, "Arrows2D:vectors"), rows(path, look.GUSTS, "Arrows2D:origins")
    np.testing.assert_allclose(vectors[72], [[0.5 * look.GUST_S2, -0.5 * look.GUST_S2]])
    np.testing.assert_array_equal(origins[72], points[72, [8]])
    words = rows(path, look.WORDS, "Points2D:labels")
    assert words[35] == ["pause of UAVs 3, 4 for 1 s\npartition of UAV 5 for 2 s"]
    assert sorted(words) == [0, 30, 35, 40, 50, 55, 60, 65, 70, 75]
    assert areas[60] == lines[65] == vectors[50] == vectors[75] == words[75] == []


@pytest.mark.parametrize("uavs", [(3, 4), (3, 4, 5), (3, 4, 5, 6), (3, 4, 5, 6, 7)])
@pytest.mark.filterwarnings("error")  # Rerun warns that it does not know which of both is meant
def test_three_or_four_colours_in_a_block_are_no_channels_of_one(uavs: tuple[int, ...], tmp_path: Path) -> None:
    path = tmp_path / "frozen.rrd"
    record(path, flight(ticks=40), faults=(Pause(tick=19, duration_s=0.1, uavs=uavs),))  # the last tick of a block
    assert rows(path, look.HALOS, "Points2D:colors")[19] == [drawing.FROZEN] * len(uavs)


def test_lanes_show_frozen_and_isolated_uavs_and_the_lost_stay_lost(tmp_path: Path) -> None:
    path, blocks = tmp_path / "lanes.rrd", flight(ticks=60)
    lost = np.concatenate([block.status for block in blocks])
    lost[40:, 4] = Status.LOST
    changed: list[Telemetry] = [
        msgspec.structs.replace(block, status=lost[block.first_tick : block.first_tick + 20]) for block in blocks
    ]
    record(path, changed, faults=(Pause(tick=30, duration_s=2.0, uavs=(3, 4)), SCRIPT[1]))
    lanes = rows(path, look.LANES, "StateChange:state")
    assert sorted(lanes) == [0, 30, 35, 40, 50, 55]
    assert lanes[30][3] == "UAV 3: frozen"
    assert lanes[35][5] == "UAV 5: cut off"
    assert lanes[40][4] == "UAV 4: lost"
    assert lanes[50][3:6] == ["UAV 3: flying", "UAV 4: lost", "UAV 5: cut off"]
    shown = rows(path, look.UAVS, "Points2D:colors")
    assert shown[40][4] == drawing.GREY
    assert shown[39][4] != drawing.GREY


def test_heads_of_clusters_are_marked_and_faults_that_are_not_there_are_not(tmp_path: Path) -> None:
    path, blocks = tmp_path / "heads.rrd", flight(ticks=40)
    record(path, blocks, federation=Federation(clusters=5))
    points = np.concatenate([block.states for block in blocks])[:, [0, 5, 10, 15, 20], :2]
    ticks, heads = column(path, look.HEADS, "Points2D:positions")
    np.testing.assert_array_equal(ticks, np.arange(40))
    np.testing.assert_array_equal(heads, points.astype(np.float32))
    for word, shown in (("head", ["head"]), ("delivered", ["delivered"]), ("jammed", [])):
        assert fixed(path, f"map/legend/{word}/word", "Points2D:labels") == shown
    assert not len(column(path, look.HALOS, "Points2D:positions")[0])


def test_the_key_of_the_map_has_every_mark_in_its_colour(disturbed: tuple[Path, np.ndarray]) -> None:
    path = disturbed[0]
    for word in ("delivered", "outage", "collision", "frozen", "cut off", "jammed", "gust", "lost"):
        assert fixed(path, f"map/legend/{word.replace(' ', '_')}/word", "Points2D:labels") == [word]
    assert fixed(path, "map/legend/wind/word", "Points2D:labels") == ["mean wind 1.4 m/s"]
    ((left, right),) = fixed(path, "map/legend/scale", "LineStrips2D:strips")
    assert fixed(path, "map/legend/scale/word", "Points2D:labels") == [f"{right[0] - left[0]:g} m"]
    assert fixed(path, look.UAVS, "Points2D:labels")[7] == "UAV 7"
    assert fixed(path, look.UAVS, "Points2D:show_labels") == [False]
    assert fixed(path, "map/legend/outage", "LineStrips2D:colors") == [drawing.RED]
    assert fixed(path, look.COLLISIONS, "LineStrips2D:colors") == [drawing.COLLISION]
    assert fixed(path, plots.HITS, "SeriesPoints:colors") == [drawing.COLLISION]
    assert fixed(path, plots.FAILURES.entity, "SeriesLines:colors") == [drawing.RED, drawing.COLLISION]
    scales = [np.array(fixed(path, entity, "Transform3D:scale")[0]) for entity in (look.MAP, look.CLOSE_UP)]
    np.testing.assert_array_equal(scales[0] * scales[1], 1.0)  # else the close-up is mirrored


MISSIONS = ("swap", "streams", "obstacles", "windmap")


@pytest.fixture(scope="module")
def missions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    out = tmp_path_factory.mktemp("missions")
    paths = {}
    for name in MISSIONS:
        paths[name] = out / f"{name}.rrd"
        flown = load(Path(name), method="cruise")
        with Recorder(flown, name, paths[name], reported=Reported((), 0)):
            pass
    return paths


def test_goals_starts_and_discs_lie_where_the_mission_has_them(missions: dict[str, Path]) -> None:
    for name in ("swap", "streams"):
        flown = load(Path(name))
        for entity, places in (("map/goal", goals(flown)), ("map/start", starts(flown)[:, :2])):
            np.testing.assert_allclose(fixed(missions[name], entity, "Points2D:positions"), places, atol=1e-4)
    discs = obstacles(load(Path("obstacles")))
    np.testing.assert_allclose(fixed(missions["obstacles"], "map/obstacles", "Points2D:positions"), discs[:, :2])
    np.testing.assert_allclose(fixed(missions["obstacles"], "map/obstacles", "Points2D:radii"), discs[:, 2])
    for name in (*MISSIONS, "paper"):
        flown = load(Path(name))
        low, high = mission_map.box(flown)
        for places in (starts(flown)[:, :2], goals(flown)):
            assert ((places >= low) & (places <= high)).all()


def test_arrows_show_the_wind_at_their_places(missions: dict[str, Path]) -> None:
    flown, path = load(Path("windmap")), missions["windmap"]
    vectors = np.array(fixed(path, "map/wind", "Arrows2D:vectors"))
    middles = np.array(fixed(path, "map/wind", "Arrows2D:origins")) + vectors / 2
    wind = MeanWind(flown)(np.concatenate([middles, np.zeros_like(middles)], axis=-1))
    ratio = np.hypot(*vectors.T) / np.hypot(*wind.T)
    np.testing.assert_allclose(vectors, wind * ratio[:, None], atol=1e-3)
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-3)
    assert len(middles) > 80


def test_an_obstacle_hit_has_its_own_mark(tmp_path: Path) -> None:
    keys: dict[str, Any] = {"obstacles": [{"centre": [145.0, 96.0], "radius": 2.0}], "wind.sigma": 0.0}
    run = mf.fly(method="cruise", uavs=4, duration=8.0, out=tmp_path, record=True, **keys)
    assert run.summary["obstacle_hits"] > 0
    hits = [event for event in run.events if event["kind"] == "hit"]
    assert len(hits) == run.summary["obstacle_hits"]
    crosses = rows(run.recording, look.OBSTACLE_HITS, "LineStrips2D:strips")
    assert set(crosses) == {event["tick"] for event in hits}
    stars = rows(run.recording, look.COLLISIONS, "LineStrips2D:strips")
    assert set(stars) == {event["tick"] for event in run.events if event["kind"] == "collision"}
    assert len(np.ravel(crosses[hits[0]["tick"]])) != len(np.ravel(drawing.STAR))
    shades = {kind: fixed(run.recording, kind, "LineStrips2D:colors") for kind in (look.OBSTACLE_HITS, look.COLLISIONS)}
    assert shades[look.OBSTACLE_HITS] != shades[look.COLLISIONS]
    levels = rows(run.recording, "events", "TextLog:level")
    assert "ERROR" in levels[hits[0]["tick"]]
    assert fixed(run.recording, "map/obstacles/edges", "LineStrips2D:colors") == [drawing.GREY]
    (ax, *_) = plot_run(run.folder)["paths"].axes
    drawn = {str(line.get_label()): line for line in ax.lines}
    crosses, stars = drawn[f"obstacle hits: {len(hits)}"], drawn[f"collisions: {run.summary['collisions']}"]
    assert len(crosses.get_xydata()) == len(hits)
    assert (crosses.get_marker(), crosses.get_color()) != (stars.get_marker(), stars.get_color())
    plt.close("all")


# Linear RGB as it is seen: Machado, Oliveira and Fernandes, IEEE TVCG 15 (2009), severity 1.


def test_a_diagnostic_counts_from_the_tick_on_in_which_a_uav_has_it(tmp_path: Path) -> None:
    first, second = flight(uavs=4, ticks=40)
    has = np.zeros((20, 4, 3), dtype=np.uint8)
    has[10:, 1, 2] = 1
    record(tmp_path / "run.rrd", [msgspec.structs.replace(first, has_diagnostic=has), second], uavs=4)
    ticks, lines = scalars(tmp_path / "run.rrd", plots.diagnostic("phi_G"))
    assert ticks.tolist() == list(range(10, 40))
    alone = first.diagnostics[10:, 1, 2].astype(np.float64)
    np.testing.assert_array_equal(lines[:10], np.stack([alone] * 3, axis=-1))
    np.testing.assert_allclose(lines[10:, 0], second.diagnostics[..., 2].mean(axis=1), rtol=1e-6)
