"""Recordings and plots of a mission: goals, discs, wind and obstacles that were hit."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Circle

import meanflock as mf
from meanflock.groundstation.plots.run import plot_run
from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import drawing, mission_map
from meanflock.groundstation.recording.recorder import Recorder
from meanflock.groundstation.results.series import Reported
from meanflock.swarm.mission import goals, obstacles, starts
from meanflock.swarm.scenario import load
from meanflock.worldsim.vehicles.base import MeanWind
from tests.groundstation.recordings import fixed, rows

pytestmark = pytest.mark.usefixtures("strict")

MISSIONS = ("swap", "streams", "obstacles", "windmap")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    out = tmp_path_factory.mktemp("missions")
    made = {}
    for name in MISSIONS:
        made[name] = out / f"{name}.rrd"
        flown = load(Path(name), method="cruise")
        with Recorder(flown, name, made[name], reported=Reported((), 0)):
            pass
    return made


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
    assert run.recording is not None
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
    assert run.folder is not None
    (ax, *_) = plot_run(run.folder)["paths"].axes
    drawn = {str(line.get_label()): line for line in ax.lines}
    crosses, stars = drawn[f"obstacle hits: {len(hits)}"], drawn[f"collisions: {run.summary['collisions']}"]
    assert len(crosses.get_xydata()) == len(hits)
    assert (crosses.get_marker(), crosses.get_color()) != (stars.get_marker(), stars.get_color())
    plt.close("all")


def test_a_plot_of_paths_has_discs_and_own_goals(tmp_path: Path) -> None:
    keys: dict[str, Any] = {"obstacles": [{"centre": [10.0, 5.0], "radius": 2.0}]}
    run = mf.fly("swap", method="cruise", uavs=6, duration=2.0, out=tmp_path, **keys)
    assert run.folder is not None
    (ax, *_) = plot_run(run.folder)["paths"].axes
    (disc,) = [patch for patch in ax.patches if isinstance(patch, Circle)]
    assert (disc.center, disc.radius) == ((10.0, 5.0), 2.0)
    (marks,) = [line for line in ax.lines if line.get_label() == "goals"]
    assert sorted(map(tuple, np.round(marks.get_xydata(), 6))) == sorted(map(tuple, np.round(goals(run.scenario), 6)))
    plt.close("all")
