"""Blocks on their way to the time series: every block that was written whole is read back."""

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


def written(path: Path, blocks: list[Telemetry]) -> list[int]:
    """Writes the blocks and returns the length of the file after each."""
    spool, sizes = Spool(path, 0.1), []
    for block in blocks:
        spool.append(block, 100 * block.block)
        sizes.append(path.stat().st_size)
    spool.close()
    return sizes


def bare(block: Telemetry) -> pa.RecordBatch:
    return rows_of(block, 0.1)


@pytest.mark.parametrize("junk", [b"", b"\0" * 5000, b"\xff" * 5000, b"\x10" + b"\0" * 5000])
def test_rows_come_back_without_links_and_events_whatever_follows_the_last_block(junk: bytes, tmp_path: Path) -> None:
    path = tmp_path / "spool"
    written(path, BLOCKS)
    path.write_bytes(path.read_bytes() + junk)
    read = list(spooled(path))
    assert [(bare(one.block), one.block.block, one.events_bytes, one.dt) for one in read] == [
        (bare(block), block.block, 100 * block.block, 0.1) for block in BLOCKS
    ]
    assert not any(len(one.block.links) or one.block.events for one in read)


def test_every_block_before_a_cut_is_read_and_no_block_after_a_false_one(tmp_path: Path) -> None:
    path = tmp_path / "spool"
    sizes = written(path, BLOCKS)
    whole = path.read_bytes()
    for cut in (0, 7, sizes[0] - 1, sizes[0], sizes[0] + 19, sizes[0] + 20, sizes[1] - 1):
        path.write_bytes(whole[:cut])
        assert len(list(spooled(path))) == int(cut >= sizes[0])
    false = msgspec.structs.replace(BLOCKS[1], energy=np.zeros((2, 2), dtype=np.float32))
    written(tmp_path / "false", [BLOCKS[0], false, BLOCKS[2]])
    assert [one.block.block for one in spooled(tmp_path / "false")] == [0]


def test_rows_are_cut_into_blocks_where_ticks_are_missing() -> None:
    rows = pa.Table.from_batches([bare(block) for block in (BLOCKS[0], BLOCKS[2])], schema(DIAGNOSTICS))
    pieces = list(unbroken(rows, 15))
    assert [(piece["tick"][0].as_py(), len(piece)) for piece in pieces] == [(0, 15), (15, 5), (40, 10), (50, 10)]
    again = [bare(block_of(piece, 7)) for piece in pieces]
    assert pa.Table.from_batches(again, schema(DIAGNOSTICS)).equals(rows)
