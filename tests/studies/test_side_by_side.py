"""Several flights in one recording: each under its own name, all on one timeline."""

from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording.replay import verify
from meanflock.studies import side_by_side
from meanflock.swarm import state
from meanflock.swarm.errors import EXIT_DONE
from meanflock.swarm.scenario import load
from tests.groundstation.recordings import column, scalars
from tests.studies.conftest import flown

TICKS = np.arange(41)
SCENARIOS = {name: load(None, method=name, uavs=3, duration=4.0, stop="duration") for name in ("mfgfl-h", "hjb")}


def roots(path: Path) -> set[str]:
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
