"""Columns of a recording: the values of an entity's components, a row a tick, in the form Rerun sends them."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

Ticks = NDArray[np.int64]
Floats = NDArray[np.float32]
Sent = tuple[str, Ticks, list[rr.ComponentColumn]]  # entity, ticks (R,), columns of R rows

STRIPS, STRIP_COLORS = rr.LineStrips2D.descriptor_strips(), rr.LineStrips2D.descriptor_colors()
_SCALARS = rr.Scalars.descriptor_scalars()


def cut(rows: int, *parts: tuple[rr.ComponentDescriptor, rr.ComponentBatchLike]) -> list[rr.ComponentColumn]:
    """Columns of so many rows, each with an equal share of all values. Those of rerun's archetypes are cut one by one
    first, and then anew: that takes longer than to send them."""
    columns = []
    for descriptor, batch in parts:
        each = len(batch.as_arrow_array()) // rows  # 0 where there is nothing to show: a round nobody was heard in
        offsets = np.arange(rows + 1, dtype=np.int32) * np.int32(each)
        columns.append(rr.ComponentColumn(descriptor, batch, offsets=offsets))
    return columns


def scalars(plot: str, ticks: Ticks, values: NDArray[Any]) -> Iterator[Sent]:
    """The lines of a plot at ticks (R,), `values` being (R,) or (R, lines); nothing where R is 0."""
    if len(ticks):
        batch = rr.components.ScalarBatch(pa.array(values.reshape(-1).astype(np.float64, copy=False)))
        yield plot, ticks, cut(len(ticks), (_SCALARS, batch))


def strips(points: Floats) -> rr.components.LineStrip2DBatch:
    """Lines of P points each, (K, P, 2), m; from an array rerun itself makes them one by one."""
    kind = rr.components.LineStrip2DBatch._ARROW_DATATYPE
    count, each, _ = points.shape
    flat = pa.FixedSizeListArray.from_arrays(points.reshape(-1), type=kind.value_type)
    lines = pa.ListArray.from_arrays(np.arange(0, count * each + 1, each, dtype=np.int32), flat, type=kind)
    return rr.components.LineStrip2DBatch(lines)
