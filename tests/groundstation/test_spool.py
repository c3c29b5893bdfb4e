"""Blocks on their way to the time series: what was written whole is read back, whatever became of the end."""

from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pytest

from meanflock.groundstation.results.series import block_of, rows_of, schema, unbroken
from meanflock.groundstation.results.spool import Spool, spooled
from meanflock.swarm.wire.messages import Telemetry
from tests.groundstation.recordings import DIAGNOSTICS, flight

BLOCKS = flight(uavs=3, ticks=60)


def written(path: Path) -> list[int]:
    """Writes all blocks; how long the file was after each."""
    spool, sizes = Spool(path, 0.1), []
    for block in BLOCKS:
        spool.append(block, 100 * block.block)
        sizes.append(path.stat().st_size)
    spool.close()
    return sizes


def bare(block: Telemetry) -> pa.RecordBatch:
    return rows_of(block, 0.1)


def test_rows_come_back_as_they_were_and_links_and_events_do_not(tmp_path: Path) -> None:
    written(tmp_path / "spool")
    read = list(spooled(tmp_path / "spool"))
    assert [(bare(one.block), one.block.block, one.events_bytes, one.dt) for one in read] == [
        (bare(block), block.block, 100 * block.block, 0.1) for block in BLOCKS
    ]
    assert not any(len(one.block.links) or one.block.events for one in read)


def test_every_block_before_a_cut_is_there(tmp_path: Path) -> None:
    path = tmp_path / "spool"
    sizes = written(path)
    whole = path.read_bytes()
    for cut in (0, 7, sizes[0] - 1, sizes[0], sizes[0] + 19, sizes[0] + 20, sizes[1] - 1):
        path.write_bytes(whole[:cut])
        assert len(list(spooled(path))) == int(cut >= sizes[0])


@pytest.mark.parametrize("junk", [b"\0" * 5000, b"\xff" * 5000, b"\x10" + b"\0" * 5000])
def test_what_comes_after_the_last_block_is_let_be(junk: bytes, tmp_path: Path) -> None:
    path = tmp_path / "spool"
    written(path)
    path.write_bytes(path.read_bytes() + junk)
    assert len(list(spooled(path))) == len(BLOCKS)


def test_a_block_that_does_not_fit_itself_is_no_block(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "spool", 0.1)
    spool.append(BLOCKS[0], 0)
    spool.append(msgspec.structs.replace(BLOCKS[1], energy=np.zeros((2, 2), dtype=np.float32)), 0)
    spool.append(BLOCKS[2], 0)
    spool.close()
    assert [one.block.block for one in spooled(tmp_path / "spool")] == [0]


def test_rows_are_blocks_again_cut_where_ticks_are_missing() -> None:
    rows = pa.Table.from_batches([bare(block) for block in (BLOCKS[0], BLOCKS[2])], schema(DIAGNOSTICS))
    pieces = list(unbroken(rows, 15))
    assert [piece["tick"].to_pylist() for piece in pieces] == [
        [*range(15)],
        [*range(15, 20)],
        [*range(40, 50)],
        [*range(50, 60)],
    ]
    again = [bare(block_of(piece, 7)) for piece in pieces]
    assert pa.Table.from_batches(again, schema(DIAGNOSTICS)).equals(rows)
