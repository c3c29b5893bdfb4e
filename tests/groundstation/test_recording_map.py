"""The map of a recording: colours, faults while they act, heads, goals, discs, wind and obstacles that were hit."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.groundstation.plots.run import plot_run
from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import drawing, mission_map, plots
from meanflock.groundstation.recording.recorder import Recorder
from meanflock.groundstation.results.series import Reported
from meanflock.swarm.faults import Fault, Gust, Jam, Kill, Partition, Pause
from meanflock.swarm.mission import goals, obstacles, starts
from meanflock.swarm.scenario import Federation, load
from meanflock.swarm.wire.messages import Status, Telemetry
from meanflock.worldsim.vehicles.base import MeanWind
from tests.groundstation.recordings import column, fixed, flight, record, rows

pytestmark = pytest.mark.usefixtures("strict")

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
    assert words[35] == ["pause of UAV 3, 4 for 1 s\npartition of UAV 5 for 2 s"]
    assert sorted(words) == [0, 30, 35, 40, 50, 55, 60, 65, 70, 75]
    assert areas[60] == lines[65] == vectors[50] == vectors[75] == words[75] == []


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
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    out = tmp_path_factory.mktemp("missions")
    paths = {}
    for name in MISSIONS:
        paths[name] = out / f"{name}.rrd"
        flown = load(Path(name), method="cruise")
        with Recorder(flown, name, paths[name], reported=Reported((), 0)):
            pass
    return paths


def test_goals_starts_and_discs_lie_where_the_mission_has_them(recorded: dict[str, Path]) -> None:
    for name in ("swap", "streams"):
        flown = load(Path(name))
        for entity, places in (("map/goal", goals(flown)), ("map/start", starts(flown)[:, :2])):
            np.testing.assert_allclose(fixed(recorded[name], entity, "Points2D:positions"), places, atol=1e-4)
    discs = obstacles(load(Path("obstacles")))
    np.testing.assert_allclose(fixed(recorded["obstacles"], "map/obstacles", "Points2D:positions"), discs[:, :2])
    np.testing.assert_allclose(fixed(recorded["obstacles"], "map/obstacles", "Points2D:radii"), discs[:, 2])
    for name in (*MISSIONS, "paper"):
        flown = load(Path(name))
        low, high = mission_map.box(flown)
        for places in (starts(flown)[:, :2], goals(flown)):
            assert ((places >= low) & (places <= high)).all()


def test_arrows_show_the_wind_at_their_places(recorded: dict[str, Path]) -> None:
    flown, path = load(Path("windmap")), recorded["windmap"]
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
