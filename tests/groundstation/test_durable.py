"""Files after crashes and flipped bits: old or new, never other numbers; a killed recorder's rows come back."""

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from rerun.chunk import RrdReader

import meanflock as mf
from meanflock.cli.command import main
from meanflock.launch import engine
from meanflock.launch.options import FlightOptions
from meanflock.launch.outputs import Outputs
from meanflock.launch.station import StoredTelemetry
from meanflock.recording import blueprint as look
from meanflock.recording import plots
from meanflock.recording.recorder import Recorder
from meanflock.recording.replay import Continued, complete, recorded, verify
from meanflock.results.rounds_table import ROUNDS
from meanflock.results.run_folder import CHECKPOINT, EVENTS, SCENARIO, SUMMARY, RunFolder
from meanflock.results.spool import Spool, spooled
from meanflock.results.timeseries_file import SPOOL, TIMESERIES, past, read_table, recover
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.errors import BadInput
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import FrameKind, Telemetry
from tests.faults import dying
from tests.faults.conftest import Lab, scenario
from tests.groundstation.recordings import DIAGNOSTICS, column, flight

pytestmark = pytest.mark.usefixtures("strict")

SETTINGS = ("uavs=3", "seed=7", "duration=30", "stop=duration", "federation.period=40")


def test_rows_and_events_are_on_the_disk_before_the_checkpoint_and_that_before_its_name(tmp_path, monkeypatch) -> None:
    done: list[str] = []
    fsync, replace = os.fsync, os.replace

    def synced(handle: int) -> None:
        inode = os.fstat(handle).st_ino
        folder = tmp_path / "run"
        name = next((p.name for p in (folder, *folder.iterdir()) if p.stat().st_ino == inode), "elsewhere")
        done.append(re.sub(r"\.[0-9a-f]{8}\.part", ".part", name))
        fsync(handle)

    def renamed(part: Path, path: Path) -> None:
        done.append(f"→ {Path(path).name}")
        replace(part, path)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", renamed)
    monkeypatch.setattr("meanflock.launch.engine._CHECKPOINT_TICKS_AT_MOST", 100)  # as in processes
    dying.flight(tmp_path, scenarios.load(None, SETTINGS))

    def durably(name: str) -> list[str]:
        return [f".{name}.part", f"→ {name}", "run"]

    rows = [EVENTS, ".telemetry"]
    table = "timeseries.parquet"
    assert done == [
        *(*durably(SCENARIO), "elsewhere", "→ .telemetry", "run"),
        *(3 * [*rows, *durably(CHECKPOINT)]),
        *(*rows, *durably(SUMMARY), "run"),  # and the checkpoint taken away
        *durably(ROUNDS),
        *(f".{table}", f"→ {table}", "run", "run"),  # and what was spooled, last
    ]


LAST_STEPS = {  # of a run that has its summary, and may die in each
    "rounds": "meanflock.results.run_folder.write_rounds",
    "time series": "meanflock.results.run_folder.recover",
    "its name": "meanflock.results.timeseries_file.durable.move",
    "the spool": "meanflock.results.timeseries_file.durable.remove",
}
READERS: dict[str, Callable[[Path], object]] = {
    "open": mf.open,
    "plot": lambda folder: main(["plot", str(folder), "--quiet", "--csv", str(folder.parent / "rows.csv")]),
    "export": lambda folder: main(["export", str(folder), "--quiet", "--radio", str(folder.parent / "radio.json")]),
}


def die(path: Path, *_: object) -> None:
    """In place of a step; the checkpoint is deleted as by the step."""
    if path.name != CHECKPOINT:
        raise dying.Died
    path.unlink()


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("step", LAST_STEPS)
def test_a_run_that_dies_after_its_summary_has_all_its_tables_for_the_first_reader(step, reader, tmp_path) -> None:
    flown = scenario(dying.LATER)
    dying.flight(tmp_path / "whole", flown)
    with patch(LAST_STEPS[step], side_effect=die), pytest.raises(dying.Died):
        dying.flight(tmp_path / "dead", flown)
    whole, folder = (tmp_path / name / "run" for name in ("whole", "dead"))
    assert (folder / SPOOL).exists()
    READERS[reader](folder)
    assert sorted(path.name for path in folder.iterdir()) == sorted(path.name for path in whole.iterdir())
    for name in (ROUNDS, TIMESERIES):
        assert pq.read_table(folder / name).equals(pq.read_table(whole / name)), name


BLOCKS = flight(uavs=2, ticks=60)
EVENTS_BYTES = 7


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    copy = tmp_path_factory.mktemp("run")
    spool = Spool(copy / SPOOL, 0.1)
    for block in BLOCKS:
        spool.append(block, EVENTS_BYTES)
    spool.close()
    return copy


@pytest.fixture(scope="module")
def sealed(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    copy = Path(shutil.copytree(folder, tmp_path_factory.mktemp("complete") / "run"))
    recover(copy)
    return copy


def flipped(whole: bytes, place: int) -> bytes:
    return whole[:place] + bytes([whole[place] ^ 1 << place % 8]) + whole[place + 1 :]


def test_a_flipped_bit_costs_the_spool_one_block_and_a_warning(folder, tmp_path, caplog) -> None:
    path, whole = tmp_path / SPOOL, (folder / SPOOL).read_bytes()
    true = {one.block.block: control.encode(one.block) for one in spooled(folder / SPOOL)}
    assert (sorted(true), caplog.text) == ([0, 1, 2], "")
    heads = [whole.index(control.encode(msgspec.structs.replace(b, links=b.links[:0], events=()))) for b in BLOCKS]
    near = {at + k for at in heads for k in range(-40, 5) if at + k >= 0}  # with the signature of the file
    for place in sorted(near | set(range(0, len(whole), 53)) | {len(whole) - 1}):
        path.write_bytes(flipped(whole, place))
        caplog.clear()
        read = {one.block.block: control.encode(one.block) for one in spooled(path)}
        assert "damaged at byte" in caplog.text, place
        assert read.items() < true.items()


def test_a_flight_does_not_continue_over_a_damaged_block(folder: Path, tmp_path: Path) -> None:
    whole = (folder / SPOOL).read_bytes()
    (tmp_path / SPOOL).write_bytes(flipped(whole, len(whole) // 2))
    assert past(tmp_path).rows["tick"].to_pylist() == [*range(20), *range(40, 60)]
    assert past(tmp_path, 19).rows.num_rows == 20
    with pytest.raises(BadInput, match="rows before tick 45 are missing"):
        past(tmp_path, 45)


def test_a_flipped_bit_of_the_time_series_is_noticed_or_changes_nothing(sealed: Path, tmp_path: Path) -> None:
    path, whole, true = tmp_path / TIMESERIES, (sealed / TIMESERIES).read_bytes(), past(sealed)
    footer = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    assert 0 < footer < len(whole) - 1000
    places = {*range(0, footer, 211), *range(footer - 16, footer + 16), *range(footer, len(whole), 71)}
    noticed = 0
    for place in sorted(places | set(range(len(whole) - 16, len(whole)))):
        path.write_bytes(flipped(whole, place))
        try:
            read = past(tmp_path)
        except BadInput:
            noticed += 1
        else:  # a page header has numbers that no reader uses
            assert place < footer
            assert (read.next_block, read.events_bytes) == (true.next_block, EVENTS_BYTES)
            assert read.rows.schema.equals(true.rows.schema, check_metadata=True)
            assert read.rows.equals(true.rows)
    assert noticed > 0.9 * len(places)


def test_any_reader_of_parquet_reads_a_sealed_file_and_ours_one_without_a_seal(sealed: Path, tmp_path: Path) -> None:
    table = pq.read_table(sealed / TIMESERIES)
    assert table.equals(read_table(sealed / TIMESERIES))
    pq.write_table(past(sealed).rows, tmp_path / TIMESERIES, compression="zstd")
    assert past(tmp_path).rows.equals(past(sealed).rows)
    assert [b"seal" in (each / TIMESERIES).read_bytes() for each in (tmp_path, sealed)] == [False, True]


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
    folder = kept(tmp_path, blocks).rename(tmp_path / "renamed")
    killed(folder / "recording.rrd", blocks, sent, monkeypatch)
    assert verify(folder / "recording.rrd") is not None
    complete(folder)
    assert verify(folder / "recording.rrd") is None
    assert contents(folder / "recording.rrd") == whole
    assert len(RrdReader(folder / "recording.rrd").recordings()) == 1
    assert not list(folder.glob(".*.rrd"))
    links = np.concatenate([block.links for block in blocks[:sent]] or [blocks[0].links[:0]])  # no other file has them
    ticks, _ = column(folder / "recording.rrd", look.MODEL_LINKS, "LineStrips2D:strips")
    assert ticks.tolist() == np.unique(links[links[:, 3] != FrameKind.STATE, 0]).tolist()


@pytest.mark.parametrize("sent", [None, 3])
def test_a_recorder_that_continues_begins_with_rows_not_recorded(sent, blocks, whole, tmp_path, monkeypatch) -> None:
    folder = kept(tmp_path, blocks[:9])
    if sent is not None:  # else there was no recorder before
        killed(folder / "recording.rrd", blocks[:9], sent, monkeypatch)
    with Outputs(FLOWN, "run", FlightOptions(out=tmp_path, quiet=True), past(folder)) as outputs:
        for block in blocks[9:]:
            for sink in outputs.sinks:
                sink.write(block)
    assert contents(folder / "recording.rrd") == whole
    assert verify(folder / "recording.rrd") is None


def test_the_parts_of_a_recorder_that_was_killed_twice_are_joined(blocks, whole, tmp_path) -> None:
    path = tmp_path / "recording.rrd"
    for number in range(3):
        continued = Continued(path, "run")
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


@pytest.mark.parametrize(
    ("uavs", "realtime", "ticks"), [(2, None, 1000), (60, None, 400), (1000, None, 100), (2, 1e3, 100)]
)
def test_checkpoints_are_as_frequent_as_a_flight_is_slow(uavs: int, realtime: float | None, ticks: int) -> None:
    flown = scenarios.load(None, [f"uavs={uavs}", "duration=1"], method="offline")
    assert engine.Engine(flown, "run", sinks=[StoredTelemetry()], realtime=realtime).world._checkpoint_every == ticks
