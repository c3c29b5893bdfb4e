"""Several flights in one recording: each is whole under its own name, and all share one timeline."""

from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import mission_map
from meanflock.groundstation.recording.drawing import Part
from meanflock.groundstation.recording.mission_map import box, shape
from meanflock.groundstation.recording.replay import verify
from meanflock.groundstation.results.series import Reported
from meanflock.studies import side_by_side
from meanflock.swarm import state
from meanflock.swarm.errors import EXIT_DONE
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import Telemetry
from tests.groundstation.recordings import column, scalars

UAVS, TICKS = 3, 40


def scenarios() -> dict[str, Scenario]:
    return {name: load(None, method=name, uavs=UAVS, duration=4.0, stop="duration") for name in ("mfgfl-h", "hjb")}


def flown(scenario: Scenario) -> list[Telemetry]:
    kept = Kept()
    Engine(scenario, "alone", sinks=[kept]).complete()
    return kept.blocks


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, dict]]:
    path = tmp_path_factory.mktemp("side") / "compare.rrd"
    return path, side_by_side.record(scenarios(), path)


def test_every_flight_is_whole_under_its_own_name(recorded) -> None:
    path, summaries = recorded
    assert verify(path) is None
    for name, scenario in scenarios().items():
        blocks, part = flown(scenario), side_by_side.part_of(name)
        states = np.concatenate([block.states for block in blocks])
        ticks, positions = column(path, f"{part}/{look.UAVS}", "Points2D:positions")
        np.testing.assert_array_equal(ticks, np.arange(TICKS + 1))
        np.testing.assert_array_equal(np.array(positions), states[..., state.POSITION].astype(np.float32))
        alone = Engine(scenario, "alone").complete()
        assert summaries[name]["trajectory_sha256"] == alone["trajectory_sha256"]


def test_the_flights_share_plots_and_nothing_lies_outside_their_parts(recorded) -> None:
    path, summaries = recorded
    for name, scenario in scenarios().items():
        part = side_by_side.part_of(name)
        energy = np.concatenate([block.energy for block in flown(scenario)])
        ticks, drawn = scalars(path, f"{part}/{side_by_side.ENERGY}")
        np.testing.assert_array_equal(ticks, np.arange(TICKS + 1))
        np.testing.assert_allclose(drawn[:, 0], energy.mean(axis=1), rtol=1e-6)
        _, bits = scalars(path, f"{part}/{side_by_side.BITS}")
        assert bits[-1, 0] == pytest.approx(summaries[name]["payload_bits"]["total"] / 1e6)
    roots = {chunk.entity_path.split("/")[1] for chunk in RrdReader(path).stream() if chunk.entity_path != "/"}
    assert roots - {"__properties"} == {side_by_side.part_of(name) for name in scenarios()}


def test_both_begin_at_the_same_moment_of_one_timeline(recorded) -> None:
    path, _ = recorded
    for name in scenarios():
        seconds = []
        for chunk in RrdReader(path).stream().filter(content=f"/{side_by_side.part_of(name)}/{look.UAVS}"):
            batch = chunk.to_record_batch()
            if look.TIMELINE in batch.schema.names:
                seconds += (batch.column(look.TIMELINE).cast("int64").to_numpy() / 1e9).tolist()
        np.testing.assert_allclose(sorted(seconds), np.arange(TICKS + 1) * 0.1)


def test_compare_leaves_it_where_it_was_asked_for(run, tmp_path) -> None:
    flags = ("--seeds", "1", "--uavs", "2", "--duration", "2", "--jobs", "1", "--quiet", "--out", "out")
    code, out, _ = run("compare", "mfg", "hjb", "--record", *flags)
    assert code == EXIT_DONE
    assert "out/compare.rrd" in out.splitlines()
    assert verify(tmp_path / "out/compare.rrd") is None
    assert {chunk.entity_path.split("/")[1] for chunk in RrdReader(tmp_path / "out/compare.rrd").stream()} >= {
        "mfg",
        "hjb",
    }


WINDOW_PX = (1920.0, 1080.0)
SINGLE_PX = (960.0, 545.0)  # of the map of one flight, beside its plots
LETTER_PX, LINE_PX, PADDING_PX = 7.2, 14.0, 8.0  # of the viewer's labels
SMALL = ("start.centre=[6,4]", "destination.radius=0.5")
NORTH = ("start.centre=[-9,150]",)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6, 9])
@pytest.mark.parametrize(
    ("mission", "settings"),
    [
        *((mission, ()) for mission in ("paper", "swap", "streams", "obstacles", "hierarchical", "faults")),
        *(("paper", settings) for settings in (SMALL, NORTH)),
    ],
    ids=str,
)
def test_a_maps_key_covers_neither_itself_nor_the_mission_however_many_maps_there_are(count, mission, settings) -> None:
    flown = load(Path(mission), settings)
    rows, columns = shape(count)
    bounds = (
        look.swarm_map(flown, "map", "map", count).properties["VisualBounds2D"].range.as_arrow_array().to_pylist()[0]
    )
    across, up = bounds["x_range"][1] - bounds["x_range"][0], bounds["y_range"][1] - bounds["y_range"][0]
    title, plots, frame = 30.0, 280.0, 70.0
    view = (WINDOW_PX[0] / columns, (WINDOW_PX[1] - plots - frame) / rows - title) if count > 1 else SINGLE_PX
    scale = min(view[0] / across, view[1] / up)  # pixels a metre
    stream = Labels()
    mission_map.log(stream, flown, Reported.by(flown.declared), count)
    boxes = [
        (x * scale - w / 2, -y * scale, x * scale + w / 2, -y * scale + LINE_PX)
        for (x, y), word in stream.words
        for w in [LETTER_PX * len(word) + PADDING_PX]
    ]
    assert len(boxes) >= 7
    covered = [
        (stream.words[i][1], stream.words[j][1])
        for i, a in enumerate(boxes)
        for j, b in enumerate(boxes[:i])
        if a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
    ]
    assert covered == []
    beside = box(flown)[0][0] * scale + PADDING_PX
    middle = (bounds["x_range"][0] + bounds["x_range"][1]) / 2 * scale, sum(bounds["y_range"]) / 2 * scale
    for left, upper, right, lower in boxes:
        assert middle[0] - view[0] / 2 <= left + PADDING_PX < right <= beside
        assert middle[1] - view[1] / 2 <= upper < lower <= middle[1] + view[1] / 2


class Labels(Part):
    """What is written into the key of a map, and where, m."""

    def __init__(self) -> None:
        self.words: list[tuple[tuple[float, float], str]] = []

    def log(self, entity: str, what: rr.AsComponents) -> None:
        if entity.startswith("map/legend/") and isinstance(what, rr.Points2D):
            parts = {
                batch.component_descriptor().component: batch.as_arrow_array().to_pylist()
                for batch in what.as_component_batches()
            }
            self.words.append((tuple(parts["Points2D:positions"][0]), parts["Points2D:labels"][0]))
