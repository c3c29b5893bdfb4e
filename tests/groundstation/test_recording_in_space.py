"""A recording of a flight in space: its view has the heights of the telemetry, and the plane has no such view."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

import meanflock as mf
from meanflock.launch.engine import Engine
from meanflock.recording import blueprint as look
from meanflock.recording import drawing, plots, space
from meanflock.recording.branches import IN_SPACE, MARK_M, MARKS, ON_MAP
from meanflock.recording.recorder import Recorder
from meanflock.recording.replay import complete, verify
from meanflock.recording.stage import Stage
from meanflock.results.plots.run import plot_run
from meanflock.results.run_folder import RunFolder
from meanflock.results.series import Reported
from meanflock.studies import side_by_side
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario, load
from tests.groundstation.recordings import (
    COLLISIONS,
    DIAGNOSTICS,
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

MAST: Any = {"stations": ({"place": (10.0, 20.0, 25.0)},)}
OBSTACLES: Any = {"obstacles": ({"centre": (80.0, 60.0), "radius": 3.0}, {"centre": (60.0, 20.0), "radius": 2.0})}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray, Scenario]:
    """A recording in space, its states, (T, N, 6), and its scenario."""
    path, blocks = tmp_path_factory.mktemp("space") / "recording.rrd", flight(axes=state.SPACE)
    flown = record(path, blocks, Reported(DIAGNOSTICS, WEIGHTS), **MAST, **OBSTACLES)
    return path, np.concatenate([block.states for block in blocks]), flown


def entities(path: Path) -> set[str]:
    return {str(chunk.entity_path).lstrip("/") for chunk in RrdReader(path).stream()}


def test_what_moves_is_drawn_at_its_height_and_on_the_map_from_above(recorded) -> None:
    path, states, _ = recorded
    assert verify(path) is None
    positions = state.position(states).astype(np.float32)
    for branch, points in ((IN_SPACE, positions), (ON_MAP, positions[..., :2])):
        kind = f"{branch.axes}D"
        np.testing.assert_array_equal(column(path, branch.uavs, f"Points{kind}:positions")[1], points)
        _, vectors = column(path, branch.velocity, f"Arrows{kind}:vectors")
        velocities = state.velocity(states)[..., : branch.axes]
        np.testing.assert_allclose(vectors, velocities * look.ARROW_S, rtol=1e-6)
        ticks, strips = column(path, branch.trails, f"LineStrips{kind}:strips")
        np.testing.assert_array_equal(np.array(strips)[:, :, -1], points[ticks])
        assert rows(path, branch.uavs, f"Points{kind}:colors")[450][7] == drawing.GREY  # the lost one
    _, frames = column(path, IN_SPACE.leader, "Transform3D:translation")
    np.testing.assert_array_equal(np.array(frames)[:, 0], positions[:, 0])
    shades = [column(path, b.uavs, f"Points{b.axes}D:colors")[1] for b in (IN_SPACE, ON_MAP)]
    assert shades[0] == shades[1]
    _, drops = column(path, space.DROPS, "LineStrips3D:strips")
    np.testing.assert_array_equal(np.array(drops)[:, :, 0], positions)
    np.testing.assert_array_equal(np.array(drops)[:, :, 1], positions * np.float32((1, 1, 0)))


def test_links_of_models_lead_through_space_and_those_of_states_are_on_the_map_alone(recorded) -> None:
    path, states, _ = recorded
    ticks, strips = column(path, IN_SPACE.model_links, "LineStrips3D:strips")
    np.testing.assert_array_equal(ticks, np.arange(ROUND_TICKS, 600, ROUND_TICKS))
    sources = np.arange(1, 24)
    for tick, ends in zip(ticks, strips, strict=True):
        np.testing.assert_array_equal(np.array(ends)[:, 0], states[tick, sources, :3].astype(np.float32))
    assert look.STATE_LINKS in entities(path)
    assert not [entity for entity in entities(path) if entity.startswith("space/links/states")]


def test_collisions_and_groundings_are_marked_where_they_happen(recorded) -> None:
    path, states, _ = recorded
    ticks, strips = column(path, IN_SPACE.marks["collision"], "LineStrips3D:strips")
    np.testing.assert_array_equal(ticks, [tick for tick, _ in COLLISIONS])
    for (tick, pair), (mark,) in zip(COLLISIONS, strips, strict=True):
        middle = states[tick, pair, :3].mean(axis=0)
        np.testing.assert_allclose(mark, middle + MARK_M * MARKS["collision"].in_space, atol=1e-3)
    for branch, place in ((IN_SPACE, states[50, 2, :3]), (ON_MAP, states[50, 2, :2])):
        kind, mark = f"LineStrips{branch.axes}D", branch.marks["grounded"]
        assert fixed(path, mark, f"{kind}:colors") == [drawing.GROUNDED]
        ((outline,),) = rows(path, mark, f"{kind}:strips").values()
        np.testing.assert_allclose(np.mean([np.min(outline, axis=0), np.max(outline, axis=0)], axis=0), place, atol=0.1)
    assert fixed(path, "map/legend/grounded/word", "Points2D:labels") == ["grounded"]
    log = dict(zip(*column(path, look.EVENTS, "TextLog:text"), strict=True))
    assert log[50] == ["grounded: UAV 2 hit the ground"]


def test_marks_of_all_kinds_differ_and_have_one_size() -> None:
    for shapes in ([mark.on_map for mark in MARKS.values()], [mark.in_space for mark in MARKS.values()]):
        assert len({shape.tobytes() for shape in shapes}) == len(MARKS)
        np.testing.assert_allclose([np.linalg.norm(shape, axis=-1).max() for shape in shapes], 1.2, atol=0.2)


def test_altitudes_are_plotted(recorded) -> None:
    path, states, _ = recorded
    heights = states[..., 2]
    ticks, values = scalars(path, plots.ALTITUDE)
    np.testing.assert_array_equal(ticks, np.arange(600))
    np.testing.assert_allclose(values, np.stack([heights.mean(1), heights.min(1), heights.max(1)], axis=-1))


def test_the_mission_stands_at_its_heights(recorded) -> None:
    path, _, flown = recorded
    starts, top = state.position(mission.starts(flown)), Stage(flown, 1).heights[-1]
    np.testing.assert_allclose(fixed(path, "space/start", "Points3D:positions"), starts, rtol=1e-6)
    np.testing.assert_allclose(fixed(path, "space/goal", "Ellipsoids3D:centers")[0], (0.0, 0.0, 40.0), atol=1e-6)
    ((foot, antenna),) = fixed(path, "space/stations", "LineStrips3D:strips")
    assert (foot, antenna) == ([10.0, 20.0, 0.0], [10.0, 20.0, 25.0])
    assert fixed(path, space.COLUMNS, "Cylinders3D:lengths") == [top, top]
    assert fixed(path, space.COLUMNS, "Cylinders3D:radii") == [3.0, 2.0]
    assert fixed(path, space.COLUMNS, "Cylinders3D:centers")[0] == [80.0, 60.0, top / 2]
    labels = fixed(path, f"{space.HEIGHTS}/words", "Points3D:labels")
    assert (labels[0], labels[-1]) == ("0 m", f"{top:g} m")
    assert all(z == 0.0 for line in fixed(path, space.GROUND, "LineStrips3D:strips") for _, _, z in line)


@pytest.mark.parametrize("maps", [1, 2, 5])
@pytest.mark.parametrize("name", ["paper", "sphere", "streams", "obstacles", "radio-mast"])
def test_the_camera_sees_the_whole_mission_and_no_more(name: str, maps: int) -> None:
    flown = load(Path(name), ["space.dimensions=3"], method="cruise")
    stage, (wide, tall) = Stage(flown, maps), look.mission_map.view_px(maps)
    camera = stage.camera
    ahead = camera.target - camera.place
    ahead /= np.linalg.norm(ahead)
    up = np.cross(camera.right, ahead)
    assert up[2] > 0.8
    places = np.concatenate([state.position(mission.starts(flown)), mission.goals(flown), stage.scale])
    places = np.concatenate([places, mission.stations(flown), places * (1.0, 1.0, 0.0)])
    depth = (places - camera.place) @ ahead
    assert (depth > 0.0).all()
    slope = math.tan(math.radians(55.0 / 2))
    across = np.abs((places - camera.place) @ camera.right) / depth / (slope * wide / tall)
    along = np.abs((places - camera.place) @ up) / depth / slope
    assert 0.75 < max(across.max(), along.max()) <= 1.0


def test_a_flight_straight_up_has_a_stage_too() -> None:
    above = {"start": {"positions": [(0.0, 0.0, 1.0)]}, "destination": {"positions": [(0.0, 0.0, 30.0)], "radius": 2.0}}
    stage = Stage(Scenario(method="cruise", uavs=1, space={"dimensions": 3}, **above), 1)
    assert (stage.low < -2.0).all()
    assert (stage.high > 2.0).all()
    assert stage.heights[-1] > 30.0
    assert np.isfinite(stage.camera.place).all()


def test_a_flight_in_the_plane_has_no_view_in_space(recorded, tmp_path: Path) -> None:
    flown = recorded[2]
    record(tmp_path / "plane.rrd", flight(ticks=60))
    assert not [entity for entity in entities(tmp_path / "plane.rrd") if "space" in entity or "ground" in entity]
    assert plots.ALTITUDE.entity not in entities(tmp_path / "plane.rrd")
    kinds = {}
    for each in (Scenario(), flown):
        shown = look.flight_blueprint(each, Reported((), 0), live=False)
        kinds[each.space.dimensions] = [view.class_identifier for view in views(shown.root_container)]
    assert "3D" not in kinds[2]
    assert sorted(set(kinds[3]) - set(kinds[2])) == ["3D"]
    assert len(kinds[3]) == len(kinds[2]) + 2  # and the plot of altitudes


def views(shown: Any) -> list[Any]:
    if not hasattr(shown, "contents") or isinstance(shown.contents, str):
        return [shown]
    inner = [views(each) for each in shown.contents if not isinstance(each, str)]
    return [shown] if hasattr(shown, "class_identifier") else [view for each in inner for view in each]


def test_a_recording_that_was_cut_off_is_completed_with_the_view_in_space(tmp_path: Path) -> None:
    flown = load(Path("sphere"), ["duration=6", "stop=duration"], uavs=6, method="cruise")
    drawn = {}
    for cut_at in (None, 25):
        out = tmp_path / str(cut_at)
        out.mkdir()
        with RunFolder(out, "flown", flown) as folder:
            path = folder.path / "recording.rrd"
            with Recorder(flown, "flown", path) as recorder:
                engine = Engine(flown, "flown", sinks=[folder, recorder])
                for tick in engine.fly():
                    if tick == cut_at:
                        recorder.flush()
                engine.finish()
        if cut_at is not None:
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
            assert verify(path) is not None
            complete(folder.path)
        assert verify(path) is None
        drawn[cut_at] = {
            entity: rows(path, entity, f"{kind}3D:{name}")
            for entity, kind, name in (
                (IN_SPACE.uavs, "Points", "positions"),
                (IN_SPACE.uavs, "Points", "colors"),
                (space.DROPS, "LineStrips", "strips"),
                (IN_SPACE.velocity, "Arrows", "vectors"),
            )
        }
        drawn[cut_at]["altitude"] = rows(path, plots.ALTITUDE.entity, "Scalars:scalars")
    assert len(drawn[None][IN_SPACE.uavs]) == 61
    assert drawn[25] == drawn[None]


def test_flights_side_by_side_have_a_view_each(tmp_path: Path) -> None:
    path = tmp_path / "beside.rrd"
    flights = {name: load(Path("sphere"), method=name, uavs=4, duration=1.0) for name in ("cruise", "orca")}
    side_by_side.record(flights, path)
    assert verify(path) is None
    for name in flights:
        assert len(rows(path, f"{name}/{IN_SPACE.uavs}", "Points3D:positions")) == 11
        assert fixed(path, f"{name}/{space.HEIGHTS}/words", "Points3D:labels")[0] == "0 m"


def test_paths_are_plotted_from_above_and_from_the_side(tmp_path: Path) -> None:
    keys = OBSTACLES | {"space.dimensions": 3, "start.layers": 2}
    run = mf.fly(method="cruise", uavs=6, duration=5.0, out=tmp_path, **keys)
    above, side = plot_run(run.folder)["paths"].axes
    for ax, up in ((above, 1), (side, 2)):
        ends = {str(line.get_label()): line.get_xydata() for line in ax.lines}["end"]
        np.testing.assert_array_equal(ends, run.states[-1][:, [0, up]])
    assert [type(patch).__name__ for patch in above.patches[:2]] == ["Circle", "Circle"]
    assert [type(patch).__name__ for patch in side.patches[:2]] == ["Rectangle", "Rectangle"]
    assert side.patches[0].get_height() == run.states[..., 2].max()
    assert (above.get_ylabel(), side.get_ylabel()) == ("$y$ (m)", "$z$ (m)")


@pytest.mark.parametrize("method", ["cruise", "mfg"])  # `mfg` has a colour bar
def test_both_panels_of_paths_in_space_have_the_same_x_axis(method: str, tmp_path: Path) -> None:
    run = mf.fly("sphere", method=method, uavs=8, duration=5.0, out=tmp_path)
    figure = plot_run(run.folder)["paths"]
    figure.draw_without_rendering()
    above, side, *bar = (ax.get_window_extent() for ax in figure.axes)
    assert (above.x0, above.x1) == pytest.approx((side.x0, side.x1), abs=1.0)
    assert above.y0 - side.y1 < 0.1 * figure.bbox.height
    assert [each.width < 0.1 * above.width for each in bar] == [True] * (method == "mfg")
