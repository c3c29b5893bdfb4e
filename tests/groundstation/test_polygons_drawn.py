"""Polygons in pictures, recordings and exports of a flight in the plane and of one in space."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.patches import Polygon, Rectangle

import meanflock as mf
from meanflock.export import messages
from meanflock.results.plots import plotstyle
from meanflock.results.plots.thumbnail import thumbnail
from meanflock.studies.leaderboard import maps
from tests.groundstation.recordings import fixed

CORNERS = ((60.0, 40.0), (80.0, 40.0), (80.0, 60.0), (70.0, 50.0))
KEYS: dict[str, Any] = {"method": "cruise", "uavs": 3, "duration": 2.0}
OBSTACLES = [{"centre": (30.0, 30.0), "radius": 4.0}, {"polygon": CORNERS}]


@pytest.fixture(scope="module", params=[2, 3])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> mf.Run:
    obstacles = [OBSTACLES[0], OBSTACLES[1] | ({"height": 25.0} if request.param == 3 else {})]
    keys = KEYS | {"obstacles": obstacles, "space.dimensions": request.param}
    return mf.fly(mf.Scenario(**keys), out=tmp_path_factory.mktemp("polygons"), record=True)


def test_the_paths_have_the_polygon_from_above_and_from_the_side(run: mf.Run) -> None:
    above, *side = run.plot("paths").axes[: run.scenario.dimensions - 1]
    (drawn,) = (patch for patch in above.patches if type(patch) is Polygon)
    assert drawn.get_xy()[:-1].tolist() == [list(corner) for corner in CORNERS]
    for ax in side:
        tall = [patch.get_bbox().bounds for patch in ax.patches if isinstance(patch, Rectangle)]
        assert (60.0, 0.0, 20.0, 25.0) in tall


@pytest.mark.parametrize(("obstacles", "marker"), [(OBSTACLES, "o"), (OBSTACLES[1:], "s")])
def test_the_legend_has_the_shape_of_the_obstacles(obstacles: list[dict[str, Any]], marker: str) -> None:
    (legend,) = mf.fly(mf.Scenario(**KEYS | {"obstacles": obstacles})).plot("paths").legends
    marks = dict(zip([text.get_text() for text in legend.get_texts()], legend.get_lines(), strict=True))
    assert marks["obstacles"].get_marker() == marker
    assert marks["obstacle hits: 0"].get_color() not in plotstyle.GROUPS


def test_a_thumbnail_and_the_map_of_a_mission_have_it(run: mf.Run) -> None:
    assert thumbnail(run._shown()).count("<polygon") == 1
    figure = maps.draw(run.scenario.replace(obstacles=OBSTACLES[1:] if run.scenario.dimensions == 2 else OBSTACLES))
    marks = {str(handle.get_label()): handle.get_marker() for handle in figure.legends[0].get_lines()}
    assert marks["obstacle"] == ("s" if run.scenario.dimensions == 2 else "o")
    (ax,) = figure.axes
    assert [patch.get_xy()[:-1].tolist() for patch in ax.patches if type(patch) is Polygon] == [
        [list(corner) for corner in CORNERS]
    ]


def test_a_recording_has_its_outline_and_in_space_its_edges(run: mf.Run) -> None:
    assert isinstance(run.recording, Path)
    disc, outline = fixed(run.recording, "map/obstacles/edges", "LineStrips2D:strips")
    np.testing.assert_allclose(outline, [*CORNERS, CORNERS[0]])
    assert len(disc) > 10
    assert fixed(run.recording, "map/obstacles", "Points2D:radii") == [4.0, 0.0]
    edges = fixed(run.recording, "space/obstacles/prisms", "LineStrips3D:strips")
    if run.scenario.dimensions == 3:
        assert [len(edge) for edge in edges] == [5, 5, 2, 2, 2, 2]
        assert {place[2] for edge in edges for place in edge} == {0.0, 25.0}
    else:
        assert edges == []


def test_an_export_has_its_sides(run: mf.Run) -> None:
    markers = [one for one in messages.goals_and_obstacles(run.scenario).markers if one.ns == "obstacles"]
    kind = type(markers[0])
    assert [one.type for one in markers] == [kind.CYLINDER, kind.TRIANGLE_LIST]
    places = np.array([(point.x, point.y, point.z) for point in markers[1].points]).reshape(-1, 3, 3)
    assert len(places) == 2 * len(CORNERS)
    sides = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
    low, high = (0.0, 25.0) if run.scenario.dimensions == 3 else (-2.0, 2.0)
    around = np.hypot(*np.diff([*CORNERS, CORNERS[0]], axis=0).T).sum()
    assert np.sqrt((sides**2).sum(axis=1)).sum() / 2 == pytest.approx(around * (high - low))
    assert (places[..., 2].min(), places[..., 2].max()) == (low, high)
