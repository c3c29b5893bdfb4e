"""Validation of telemetry and summary by the ground station."""

import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from meanflock.results.quantities import RESERVED
from meanflock.swarm import state
from meanflock.swarm.declared import MAX_DIAGNOSTICS
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.events import FlightEvent, fields_of
from meanflock.swarm.wire.control import expect
from meanflock.swarm.wire.messages import SWARM_COLUMNS, Finished, FrameKind, LinkColumn, Status, Telemetry

_LAST_TICK = 2**31 - 1  # ticks are kept in 32 bits


def check(block: Telemetry, uavs: int | None, nodes: int | None = None, dimensions: int | None = None) -> Telemetry:
    """Check that the arrays of a block have the same T ≥ 1 rows and `uavs` UAVs (None: as many as its states).

    `nodes`: number of UAVs and stations, between which there are links; None: there are no stations. `dimensions`: of
    the flight; None: 2 or 3, by its states.

    Raises:
        MessageRejected: `wrong-shape` or `non-finite`.
    """
    if block.states.ndim != 3 or not len(block.states):
        raise MessageRejected("wrong-shape", f"states of shape {block.states.shape} are no rows")
    rows, n = len(block.states), block.states.shape[1] if uavs is None else uavs
    flown = state.SPACE if block.states.shape[2] == 2 * state.SPACE else state.PLANE
    d = flown if dimensions is None else dimensions
    reports = len(expect("report_ticks", block.report_ticks, (None,), np.int32))
    for name, shape, dtype in (
        ("states", (rows, n, 2 * d), np.float64),
        ("accelerations", (rows, n, d), np.float32),
        ("diagnostics", (rows, n, len(block.diagnostic_names)), np.float32),
        ("status", (rows, n), np.uint8),
        ("energy", (rows, n), np.float32),
        ("swarm", (rows, len(SWARM_COLUMNS)), np.float64),
        ("links", (None, len(LinkColumn)), np.int32),
        ("reports", (reports, None), np.float32),
        ("spread", (reports,), np.float64),
    ):
        expect(name, getattr(block, name), shape, dtype)
    names = block.diagnostic_names
    if block.has_diagnostic is not None:
        each = (rows, n, len(names))
        expect("has_diagnostic", block.has_diagnostic, each if block.has_diagnostic.ndim == 3 else each[1:], np.uint8)
    fit = len(set(names)) == len(names) <= MAX_DIAGNOSTICS and RESERVED.isdisjoint(names)
    if not fit or not all(name.isidentifier() for name in names):
        raise MessageRejected("wrong-shape", "diagnostics without names of their own")
    if not 0 <= block.block <= _LAST_TICK or not 0 <= block.first_tick <= _LAST_TICK - rows:
        raise MessageRejected("wrong-shape", f"block {block.block} of tick {block.first_tick}")
    if (np.abs(block.states) > np.finfo(np.float32).max).any():
        raise MessageRejected("non-finite", "states beyond what a recording can hold")
    if (block.status > max(Status)).any():
        raise MessageRejected("wrong-shape", "an invalid status")
    ends, kinds = block.links[:, [LinkColumn.SOURCE, LinkColumn.TARGET]], block.links[:, LinkColumn.KIND]
    if ((ends < 0) | (ends >= (nodes or n))).any() or ((kinds < 0) | (kinds > max(FrameKind))).any():
        raise MessageRejected("wrong-shape", "links of nodes or frames that are not there")
    for event in block.events:
        if not all(map(math.isfinite, _floats(event))):
            raise MessageRejected("non-finite", f"{event.kind}: a number that is not finite")
        named = event.all_uavs
        if not 0 <= event.tick <= _LAST_TICK or any(not 0 <= uav < n for uav in named):
            raise MessageRejected("wrong-shape", f"an event of tick {event.tick} and UAVs {named}")
    return block


def _floats(event: FlightEvent) -> Iterator[float]:
    """All floats in the fields of an event."""
    for value in fields_of(event).values():
        for number in value.values() if isinstance(value, dict) else (value,):
            if isinstance(number, float):
                yield number


def summary(message: Finished) -> dict[str, Any]:
    """Read the summary in a message.

    Raises:
        MessageRejected: `malformed`: it is not a summary.
    """
    try:
        record = json.loads(message.summary)
    except (ValueError, RecursionError) as error:
        raise MessageRejected("malformed", f"summary: {error}") from error
    if not isinstance(record, dict) or not isinstance(record.get("nodes_lost"), int):
        raise MessageRejected("malformed", "the summary is not that of a run")
    return record
