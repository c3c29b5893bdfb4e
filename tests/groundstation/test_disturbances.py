"""The map shows each fault of the script while it acts, and the heads of clusters."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import drawing, plots
from meanflock.swarm.faults import Fault, Gust, Jam, Kill, Partition, Pause
from meanflock.swarm.scenario import Federation
from meanflock.swarm.wire.messages import Status, Telemetry
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
