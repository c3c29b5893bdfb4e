"""Writes examples/trace.parquet: 25 UAVs on their way to the origin, for the vehicle `trace`.

    python examples/make_trace.py examples/trace.parquet

The UAVs fly a winding way, in rows that come nearer to each other, and arrive after 80 s. The file is the same whenever
it is written.
"""

import math
import sys

import pyarrow as pa
from pyarrow import parquet

UAVS, END_S, EVERY_S = 25, 80.0, 4.0


def rows():
    """Rows t_s, uav, x_m, y_m: of all UAVs, time by time."""
    for step in range(int(END_S / EVERY_S) + 1):
        share = step * EVERY_S / END_S
        left = 1.0 - share * share * (3.0 - 2.0 * share)  # of the way, from rest to rest
        for uav in range(UAVS):
            row, column = divmod(uav, 5)
            apart = 1.2 + 2.8 * left
            sway = 12.0 * math.sin(4.0 * math.pi * share + 0.1 * row) * math.sin(math.pi * share)
            x, y = 150.0 * left + apart * (column - 2) + sway, 100.0 * left + apart * (row - 2) - sway
            yield step * EVERY_S, uav, round(x, 2), round(y, 2)


if __name__ == "__main__":
    columns = zip(*rows(), strict=True)
    types = {"t_s": pa.float32(), "uav": pa.uint8(), "x_m": pa.float32(), "y_m": pa.float32()}
    arrays = [pa.array(values, kind) for values, kind in zip(columns, types.values(), strict=True)]
    parquet.write_table(pa.table(arrays, list(types)), sys.argv[1], compression="zstd")
