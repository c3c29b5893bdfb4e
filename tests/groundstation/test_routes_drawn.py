"""Waypoints and landing places in recordings and plots, in the plane and in space."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection

import meanflock as mf
from meanflock.recording import drawing
from meanflock.recording.mission_map import box
from meanflock.recording.routes import Route, has_route, routes
from meanflock.results.plots.run import plot_run
from tests.groundstation.recordings import fixed

LANDINGS = [[200.0, -50.0], [10.0, 80.0]]
ROUTE, OWN = [[60.0, 0.0], [60.0, 60.0], [0.0, 60.0]], [[-40.0, 0.0], [-40.0, 90.0]]
KEYS: dict[str, Any] = {
    "uavs": 6,
    "method": "cruise",
    "duration": 2.0,
    "start": {"centre": [0.0, 0.0], "spacing": 4.0},
    "destination": {"waypoints": ROUTE, "radius": 3.0},
    "energy": {"battery_J": 500.0, "landings": LANDINGS},
    "groups": [
        {"name": "a", "count": 2},
        {"name": "b", "count": 2, "destination": {"waypoints": OWN}},
        {"name": "c", "count": 1},
        {"name": "d", "count": 1, "destination": {"positions": [[5.0, 5.0]]}},
    ],
}


@pytest.fixture(scope="module", params=[2, 3])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> mf.Run:
    flown = mf.Scenario(**KEYS, space={"dimensions": request.param})
    return mf.fly(flown, out=tmp_path_factory.mktemp("routes"), record=True)


def test_routes_are_those_of_the_flight_and_of_groups_that_have_their_own() -> None:
    flown = mf.Scenario(**KEYS)
    shared, own = routes(flown)
    assert (shared.name, shared.color, own.name, own.color) == ("", drawing.GREEN, "b", drawing.group_color(1))
    assert (shared.places.tolist(), own.places.tolist()) == (ROUTE, OWN)
    assert has_route(flown).tolist() == [True] * 5 + [False]
    assert routes(mf.Scenario()) == []
    long = Route("", 0, np.zeros((50, 2))).words
    assert [word for word in long if word] == ["waypoint 1", "waypoint 50"]
    low, high = box(flown)
    assert low[1] < -50.0
    assert high[0] > 200.0


def test_a_recording_has_dots_with_words_at_waypoints_and_landing_places(run: mf.Run) -> None:
    assert isinstance(run.recording, Path)
    views = ["map"] if run.scenario.dimensions == 2 else ["map", "space"]
    for view in views:
        points = "Points2D" if view == "map" else "Points3D"
        height = [] if view == "map" else [40.0]
        for name, places, color in (("all", ROUTE, drawing.GREEN), ("b", OWN, drawing.group_color(1))):
            entity = f"{view}/waypoints/{name}"
            np.testing.assert_allclose(
                fixed(run.recording, entity, f"{points}:positions"), [[*place, *height] for place in places]
            )
            assert fixed(run.recording, entity, f"{points}:colors") == [color]
            words = [f"waypoint {number}" for number in range(1, len(places) + 1)]
            assert fixed(run.recording, f"{entity}/label", f"{points}:labels") == words
        landings = fixed(run.recording, f"{view}/landings", f"{points}:positions")
        np.testing.assert_allclose(landings, [[*place, *height] for place in LANDINGS])
        assert fixed(run.recording, f"{view}/landings/label", f"{points}:labels") == ["landing", "landing"]
    assert fixed(run.recording, "map/goal/label/d", "Points2D:labels") == ["goal"]
    assert fixed(run.recording, "map/goal/label/a", "Points2D:labels") == []


def test_a_plot_shows_landing_places_from_above_and_from_the_side(run: mf.Run) -> None:
    assert run.folder is not None
    for up, ax in enumerate(plot_run(run.folder)["paths"].axes, start=1):
        (line,) = (line for line in ax.get_lines() if line.get_label() == "landing places")
        places = [[*place, 40.0] for place in LANDINGS]
        np.testing.assert_allclose(line.get_xydata(), [[place[0], place[up]] for place in places])


def test_a_plot_has_waypoints_as_marks_and_the_disc_of_a_goal_below_the_paths(run: mf.Run) -> None:
    assert run.folder is not None
    for up, ax in enumerate(plot_run(run.folder)["paths"].axes, start=1):
        lines = {str(line.get_label()): line for line in ax.get_lines()}
        height = [] if up == 1 else [np.full(len(ROUTE + OWN), run.scenario.start.height)]
        shown = np.stack([np.array(ROUTE + OWN)[:, 0], *(height or [np.array(ROUTE + OWN)[:, 1]])], axis=-1)
        np.testing.assert_allclose(lines["waypoints"].get_xydata(), np.unique(shown, axis=0))
        assert "goal, 5 m" in lines
        disc, *edges = ax.patches
        paths = [collection for collection in ax.collections if isinstance(collection, LineCollection)]
        assert disc.get_facecolor()[3] < 0.5
        assert all(disc.get_zorder() < path.get_zorder() for path in paths)
        assert not any(edge.get_fill() for edge in edges)
        assert lines["start"].get_zorder() < min(path.get_zorder() for path in paths)
