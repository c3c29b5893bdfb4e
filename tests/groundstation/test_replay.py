"""Rows that a killed recorder had not sent come back into its recording from the time series."""

from pathlib import Path
from typing import Any

import pytest

from meanflock.groundstation.launch import engine
from meanflock.groundstation.launch.options import Options
from meanflock.groundstation.launch.outputs import Outputs
from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import plots
from meanflock.groundstation.recording.recorder import Recorder
from meanflock.groundstation.recording.replay import Continued, complete, recorded, verify
from meanflock.groundstation.results.run_folder import RunFolder
from meanflock.groundstation.results.timeseries_file import past, recover
from meanflock.swarm.wire.messages import Telemetry
from tests.faults.conftest import Lab, scenario
from tests.groundstation.recordings import DIAGNOSTICS, column

pytestmark = pytest.mark.usefixtures("strict")

FLOWN = scenario(
    "duration=30", 'faults=[{kind="kill", tick=101, uavs=[2]}, {kind="pause", tick=150, duration_s=3.0, uavs=[1]}]'
)


@pytest.fixture(scope="module")
def blocks() -> list[Telemetry]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(engine, "_BLOCK_ROWS", 20)
        lab = Lab(FLOWN)
    lab.fly()
    return lab.record.blocks


def kept(out: Path, blocks: list[Telemetry]) -> Path:
    """A folder with these blocks, as a kill leaves it."""
    folder = RunFolder(out, "run", FLOWN)
    for block in blocks:
        folder.write(block)
    folder._background.wait()
    folder._spool = None
    folder._events.close()
    return folder.path


def killed(path: Path, blocks: list[Telemetry], sent: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A recording to which the recorder had sent `sent` blocks when it was killed."""
    with Recorder(FLOWN, "run", path) as recorder, monkeypatch.context() as patched:
        for block in blocks[:sent]:
            recorder.write(block)
        recorder.flush()
        patched.setattr(recorder, "flush", lambda: None)
        for block in blocks[sent:]:
            recorder.write(block)
        recorder.close()
    whole = path.read_bytes()
    path.write_bytes(whole[:-200])  # without its footer


Contents = dict[tuple[str, str], tuple[list[int], list[Any]]]
EVERYTHING = (
    (look.UAVS, "Points2D:positions"),
    (look.UAVS, "Points2D:colors"),  # of phi_G, and grey if it is lost
    (look.VELOCITY, "Arrows2D:vectors"),
    (plots.ENERGY.entity, "Scalars:scalars"),
    (plots.BITS.entity, "Scalars:scalars"),
    *((plots.diagnostic(name).entity, "Scalars:scalars") for name in DIAGNOSTICS),
    (plots.WEIGHTS, "Scalars:scalars"),
    (plots.SPREAD.entity, "Scalars:scalars"),
    (look.EVENTS, "TextLog:text"),
)


def contents(path: Path) -> Contents:
    found = {}
    for entity, name in EVERYTHING:
        ticks, rows = column(path, entity, name)
        found[entity, name] = ticks.tolist(), rows
    return found


@pytest.fixture(scope="module")
def whole(blocks: list[Telemetry], tmp_path_factory: pytest.TempPathFactory) -> Contents:
    path = tmp_path_factory.mktemp("whole") / "recording.rrd"
    with Recorder(FLOWN, "run", path) as recorder:
        for block in blocks:
            recorder.write(block)
    return contents(path)


@pytest.mark.parametrize("sent", [0, 6, 15])  # block 5 ends with tick 101, whose event is in block 6
def test_the_recording_of_a_killed_run_is_completed_to_its_last_row(sent, blocks, whole, tmp_path, monkeypatch) -> None:
    assert (blocks[6].first_tick, blocks[6].events[0].tick) == (102, 101)
    folder = kept(tmp_path, blocks)
    killed(folder / "recording.rrd", blocks, sent, monkeypatch)
    assert verify(folder / "recording.rrd") is not None
    complete(folder)
    assert verify(folder / "recording.rrd") is None
    assert contents(folder / "recording.rrd") == whole
    assert not list(folder.glob(".*.rrd"))


@pytest.mark.parametrize("sent", [None, 3])
def test_a_recorder_that_continues_begins_with_the_rows_that_were_not_recorded(
    sent: int | None, blocks: list[Telemetry], whole: Contents, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = kept(tmp_path, blocks[:9])
    if sent is not None:  # else there was no recorder before
        killed(folder / "recording.rrd", blocks[:9], sent, monkeypatch)
    with Outputs(FLOWN, "run", Options(out=tmp_path, quiet=True), past(folder)) as outputs:
        for block in blocks[9:]:
            for sink in outputs.sinks:
                sink.write(block)
    assert contents(folder / "recording.rrd") == whole
    assert verify(folder / "recording.rrd") is None


def test_the_parts_of_a_recorder_that_was_killed_twice_are_joined(blocks, whole, tmp_path) -> None:
    path = tmp_path / "recording.rrd"
    for number in range(3):
        continued = Continued(path)
        continued.__enter__()
        with Recorder(FLOWN, "run", path) as recorder:
            for block in blocks[5 * number : 5 * number + 5 if number < 2 else None]:
                recorder.write(block)
    continued.__exit__()  # the killed ones did not
    assert verify(path) is None
    assert [file.name for file in tmp_path.iterdir()] == ["recording.rrd"]
    assert recorded([path]).ticks.tolist() == whole[EVERYTHING[0]][0]


def test_a_recording_that_cannot_be_read_is_made_anew_and_the_old_one_stays_beside_it(blocks, whole, tmp_path) -> None:
    folder = kept(tmp_path, blocks)
    recover(folder)  # its rows are now in the time series
    (folder / "recording.rrd").write_bytes(b"no recording")
    path = folder / "scenario.toml"  # the controller need not be installed
    path.write_text(path.read_text().replace('method = "mfgfl-h"', 'method = "nobody-has-it"'))
    complete(folder)
    assert contents(folder / "recording.rrd") == whole
    assert (folder / ".earlier-000.recording.rrd").read_bytes() == b"no recording"
