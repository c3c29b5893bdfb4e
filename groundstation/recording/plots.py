"""The lines of a recording's plots over time, out of telemetry."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.meter import TRAFFIC
from meanflock.groundstation.lines import log_sizes, span, span_of
from meanflock.groundstation.recording import panels
from meanflock.groundstation.recording.columns import Floats, Sent, Ticks, scalars
from meanflock.groundstation.reported import Reported
from meanflock.swarm import state
from meanflock.swarm.wire.messages import SWARM_COLUMNS, Status, Telemetry

COLUMN = {name: index for index, name in enumerate(SWARM_COLUMNS)}
BITS_SENT = [COLUMN[f"{name}_bits"] for name in TRAFFIC.values()]


def plot_rows(
    ticks: Ticks,
    states: state.States,
    diagnostics: Floats,
    swarm: NDArray[np.float64],
    energy: Floats,
    status: NDArray[np.uint8],
    names: Sequence[str],
) -> Iterator[Sent]:
    """Scalars at ticks (T,), with `panels.LAST` as the last.

    Args:
        states: (T, N, 4). diagnostics: (T, N, K), called `names`. swarm: (T, columns), as in `SWARM_COLUMNS`.
        energy: (T, N), J. status: (T, N).
    """

    def columns(*names: str) -> NDArray[np.float64]:
        return swarm[:, [COLUMN[name] for name in names]]

    yield from scalars(panels.SPEED.entity, ticks, span(state.speed(states)))
    yield from scalars(panels.BITS.entity, ticks, swarm[:, BITS_SENT] / 1e6)
    yield from scalars(panels.ALIGNMENT.entity, ticks, columns("phi_A"))
    yield from scalars(panels.RISK.entity, ticks, columns("phi_C", "phi_C_distinct"))
    yield from scalars(panels.FAILURES.entity, ticks, columns("outages", "collisions"))
    for number, name in enumerate(names):
        yield from _diagnostic(panels.diagnostic(name), ticks, diagnostics[..., number], status != Status.LOST)
    yield from scalars(panels.LAST.entity, ticks, span(energy))


def _diagnostic(plot: panels.Plot, ticks: Ticks, values: NDArray[Any], who: NDArray[np.bool_]) -> Iterator[Sent]:
    """Of the UAVs `who` (T, N): those that are lost report nothing."""
    if plot.log10:
        known, lines = log_sizes(values)
        yield from scalars(plot.entity, ticks if known.all() else ticks[known], lines)
    else:  # at take-off nothing was reported yet
        flown = who.any(axis=1) & (ticks > 0)
        yield from scalars(plot.entity, ticks[flown], span_of(values[flown], who[flown]))


def report_rows(blocks: Sequence[Telemetry], reported: Reported) -> Iterator[Sent]:
    """What the leader's UAV has learned and the spread of all models, where the world asked for them."""
    if not reported.weights:
        return
    ticks = np.concatenate([block.report_ticks for block in blocks]).astype(np.int64)
    reports = np.concatenate([block.reports for block in blocks])
    yield from scalars(panels.WEIGHTS, ticks, reports[:, reported.drawn])
    yield from scalars(panels.SPREAD.entity, ticks, np.concatenate([block.spread for block in blocks]))
