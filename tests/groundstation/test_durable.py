"""Files after crashes and flipped bits: old or new, and never other numbers."""

import os
import shutil
from pathlib import Path

import msgspec
import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.results.run_folder import (
    CHECKPOINT,
    EVENTS,
    SCENARIO,
    SUMMARY,
)
from meanflock.groundstation.results.spool import Spool, spooled
from meanflock.groundstation.results.timeseries_file import SPOOL, TIMESERIES, past, read_table, recover
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.errors import BadInput
from meanflock.swarm.wire import control
from tests.faults import dying
from tests.groundstation.recordings import flight

SETTINGS = ("uavs=3", "seed=7", "duration=30", "stop=duration", "federation.period=40")


def test_rows_and_events_are_on_the_disk_before_the_checkpoint_and_that_before_its_name(tmp_path, monkeypatch) -> None:
    done: list[str] = []
    fsync, replace = os.fsync, os.replace

    def synced(handle: int) -> None:
        inode = os.fstat(handle).st_ino
        folder = tmp_path / "run"
        done.append(next((p.name for p in (folder, *folder.iterdir()) if p.stat().st_ino == inode), "elsewhere"))
        fsync(handle)

    def renamed(part: Path, path: Path) -> None:
        done.append(f"→ {Path(path).name}")
        replace(part, path)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", renamed)
    monkeypatch.setattr("meanflock.groundstation.launch.engine._CHECKPOINT_TICKS_AT_MOST", 100)  # as in processes
    dying.flight(tmp_path, scenarios.load(None, SETTINGS))

    def durably(name: str) -> list[str]:
        return [f".{name}.part", f"→ {name}", "run"]

    rows = [EVENTS, ".telemetry"]
    table = "timeseries.parquet"
    assert done == [
        *(*durably(SCENARIO), "elsewhere", "→ .telemetry", "run"),
        *(3 * [*rows, *durably(CHECKPOINT)]),
        *(*rows, *durably(SUMMARY), "run"),  # and the checkpoint taken away
        *(f".{table}", f"→ {table}", "run", "run"),  # and what was spooled
    ]


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
def complete(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
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


def test_a_flipped_bit_of_the_time_series_is_noticed_or_changes_nothing(complete: Path, tmp_path: Path) -> None:
    path, whole, true = tmp_path / TIMESERIES, (complete / TIMESERIES).read_bytes(), past(complete)
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


def test_any_reader_of_parquet_reads_a_sealed_file_and_ours_one_without_a_seal(complete: Path, tmp_path: Path) -> None:
    table = pq.read_table(complete / TIMESERIES)
    assert table.equals(read_table(complete / TIMESERIES))
    pq.write_table(past(complete).rows, tmp_path / TIMESERIES, compression="zstd")
    assert past(tmp_path).rows.equals(past(complete).rows)
    assert [b"seal" in (each / TIMESERIES).read_bytes() for each in (tmp_path, complete)] == [False, True]
