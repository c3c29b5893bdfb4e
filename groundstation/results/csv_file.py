"""The time series of a run as a CSV file."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal, TypeAlias

import pyarrow as pa
from pyarrow import csv

from meanflock.groundstation.results.series import long_form
from meanflock.swarm import durable

Per: TypeAlias = Literal["uav", "tick"]  # a row a tick and UAV, or a row a tick
_ENTRIES = 100_000  # rows times UAVs that are converted at once
_NO_HEADER = csv.WriteOptions(include_header=False)


def write_csv(rows: pa.Table, path: Path, per: Per, progress: Callable[[int, int], None]) -> Path:
    """Writes the rows of a time series; nothing is at `path` before the last row is written.

    Floats have the digits that read back as the same float64. With a row a tick, columns of lists are left out.

    Args:
        progress: called with the ticks written and all ticks.

    Raises:
        BadInput: no file can be made there.
        RunFailed: the disk is full.
    """
    ticks, uavs = len(rows), len(rows["x_m"][0]) if len(rows) else 0
    at_once = max(1, _ENTRIES // max(1, uavs))
    with durable.replacing(path) as file:
        durable.write(file, (",".join(_flat(rows.slice(0, 0), per).column_names) + "\n").encode())
        for first in range(0, ticks, at_once):
            text = pa.BufferOutputStream()
            csv.write_csv(_flat(rows.slice(first, at_once), per), text, _NO_HEADER)
            durable.write(file, memoryview(text.getvalue()))
            progress(min(first + at_once, ticks), ticks)
    return path


def _flat(rows: pa.Table, per: Per) -> pa.Table:
    """Rows without lists. float32 becomes float64: its shortest digits would read back as another float64."""
    if per == "uav":
        flat = long_form(rows)
    else:
        flat = rows.select([field.name for field in rows.schema if not pa.types.is_list(field.type)])
    wide = [field.with_type(pa.float64()) if field.type == pa.float32() else field for field in flat.schema]
    return flat.cast(pa.schema(wide))
