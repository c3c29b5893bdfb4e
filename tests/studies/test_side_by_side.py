"""Several flights in one recording: each under its own name, all on one timeline."""

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
from meanflock.swarm.scenario import load
from tests.groundstation.recordings import column, scalars
from tests.studies.studies import flown

TICKS = np.arange(41)
SCENARIOS = {name: load(None, method=name, uavs=3, duration=4.0, stop="duration") for name in ("mfgfl-h", "hjb")}


def roots(path: Path) -> set[str]:
    """The first parts of all entities."""
    return {chunk.entity_path.split("/")[1] for chunk in RrdReader(path).stream() if chunk.entity_path != "/"}


@pytest.mark.usefixtures("undrawn")
def test_compare_records_every_flight_under_its_own_name_on_one_timeline(run, tmp_path: Path) -> None:
    flags = ("--seeds", "1", "--uavs", "3", "--duration", "4", "--set", "stop=duration", "--jobs", "1", "--quiet")
    code, out, _ = run("compare", *SCENARIOS, "--record", *flags, "--out", "out")
    assert (code, "out/compare.rrd" in out.splitlines()) == (EXIT_DONE, True)
    path = tmp_path / "out/compare.rrd"
    summaries = {summary["method"]: summary for summary in flown(tmp_path / "out")}
    assert verify(path) is None
    assert roots(path) - {"__properties"} == {side_by_side.part_of(name) for name in SCENARIOS}
    for name, scenario in SCENARIOS.items():
        kept, part = Kept(), side_by_side.part_of(name)
        alone = Engine(scenario, "alone", sinks=[kept]).complete()
        assert summaries[name]["trajectory_sha256"] == alone["trajectory_sha256"]
        states = np.concatenate([block.states for block in kept.blocks])
        ticks, positions = column(path, f"{part}/{look.UAVS}", "Points2D:positions")
        np.testing.assert_array_equal(ticks, TICKS)
        np.testing.assert_array_equal(np.array(positions), states[..., state.POSITION].astype(np.float32))
        ticks, drawn = scalars(path, f"{part}/{side_by_side.ENERGY}")
        np.testing.assert_array_equal(ticks, TICKS)
        energy = np.concatenate([block.energy for block in kept.blocks])
        np.testing.assert_allclose(drawn[:, 0], energy.mean(axis=1), rtol=1e-6)
        _, bits = scalars(path, f"{part}/{side_by_side.BITS}")
        assert bits[-1, 0] == pytest.approx(alone["payload_bits"]["total"] / 1e6)


WINDOW_PX = (1920.0, 1080.0)
SINGLE_PX = (960.0, 545.0)  # of the map of one flight, beside its plots
LETTER_PX, LINE_PX, PADDING_PX = 7.2, 14.0, 8.0  # of the viewer's labels
SMALL = ("start.centre=[6,4]", "destination.radius=0.5")
NORTH = ("start.centre=[-9,150]",)


@pytest.mark.parametrize("count", [1, 4, 9])
@pytest.mark.parametrize(
    ("mission", "settings"),
    [
        *((mission, ()) for mission in ("paper", "swap", "streams", "obstacles", "hierarchical", "faults")),
        *(("paper", settings) for settings in (SMALL, NORTH)),
    ],
    ids=str,
)
def test_the_key_of_a_map_covers_neither_itself_nor_the_mission(count, mission, settings) -> None:
    shown = load(Path(mission), settings)
    rows, columns = shape(count)
    bounds = (
        look.swarm_map(shown, "map", "map", count).properties["VisualBounds2D"].range.as_arrow_array().to_pylist()[0]
    )
    across, up = bounds["x_range"][1] - bounds["x_range"][0], bounds["y_range"][1] - bounds["y_range"][0]
    title, plots, frame = 30.0, 280.0, 70.0
    view = (WINDOW_PX[0] / columns, (WINDOW_PX[1] - plots - frame) / rows - title) if count > 1 else SINGLE_PX
    scale = min(view[0] / across, view[1] / up)  # pixels a metre
    stream = Labels()
    mission_map.log(stream, shown, Reported.by(shown.declared), count)
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
    beside = box(shown)[0][0] * scale + PADDING_PX
    middle = (bounds["x_range"][0] + bounds["x_range"][1]) / 2 * scale, sum(bounds["y_range"]) / 2 * scale
    for left, upper, right, lower in boxes:
        assert middle[0] - view[0] / 2 <= left + PADDING_PX < right <= beside
        assert middle[1] - view[1] / 2 <= upper < lower <= middle[1] + view[1] / 2


class Labels(Part):
    """The words in the key of a map, each with its position in metres."""

    def __init__(self) -> None:
        self.words: list[tuple[tuple[float, float], str]] = []

    def log(self, entity: str, what: rr.AsComponents) -> None:
        if entity.startswith("map/legend/") and isinstance(what, rr.Points2D):
            parts = {
                batch.component_descriptor().component: batch.as_arrow_array().to_pylist()
                for batch in what.as_component_batches()
            }
            self.words.append((tuple(parts["Points2D:positions"][0]), parts["Points2D:labels"][0]))
