"""The curves of one run: a panel a quantity of its time series, and one more for whatever its controller reports."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from numpy.typing import NDArray

from meanflock.channel.meter import TRAFFIC
from meanflock.groundstation.plots import plotstyle
from meanflock.groundstation.results.quantities import FIELDS, quantity
from meanflock.groundstation.results.series import diagnostics_in, span_where
from meanflock.swarm.wire.messages import Status

Floats = NDArray[np.float64]

MAX_POINTS = 1500  # of a curve, instants of a path


def grid(table: pa.Table, column: str) -> Floats:
    """A list column as `(T, N)`."""
    values = table.column(column).combine_chunks()
    return np.array(values.values.to_numpy(zero_copy_only=False), dtype=np.float64).reshape(table.num_rows, -1)


def line(table: pa.Table, column: str) -> Floats:
    """A column of numbers, `(T,)`."""
    return np.asarray(table.column(column).to_numpy(), dtype=np.float64)


class Panel(NamedTuple):
    """A plot over time. label: of its y axis."""

    title: str
    label: str
    draw: Callable[[Axes], None]


class Curves:
    """The panels of a time series."""

    def __init__(self, table: pa.Table, tone: str) -> None:
        """`tone`: the colour of the lines."""
        self._table, self._tone = table, tone
        self._step = max(1, table.num_rows // MAX_POINTS)
        self._times = line(table, "sim_time_s")[:: self._step]
        self._uavs = len(table["x_m"][0])

    def panels(self) -> list[Panel]:
        """Those of every flight, then those of what the controller reports."""
        axis, arrived = plotstyle.axis, FIELDS["arrived"].name
        speed = np.hypot(grid(self._table, "vx_m_s"), grid(self._table, "vy_m_s"))
        panels = [
            Panel(_ranged("energy_J"), axis("energy_J"), partial(self._span, grid(self._table, "energy_J"))),
            Panel(_ranged("speed_mean_m_s"), axis("speed_mean_m_s"), partial(self._span, speed)),
            Panel(FIELDS["payload_bits.total"].name, axis("payload_bits.total"), self._bits),
            Panel(FIELDS["phi_A"].remarked, axis("phi_A"), self._alignment),
            Panel("collision risk φ_C", axis("phi_C"), self._risk),
            Panel(f"{arrived} and collisions", "UAVs, pairs", self._arrived),
            *map(self._diagnostic, diagnostics_in(self._table.schema)),
        ]
        if self._table["weight_spread"].null_count < self._table.num_rows:
            panels.append(Panel(FIELDS["weight_spread"].name, axis("weight_spread"), self._spread))
        return panels

    def _diagnostic(self, name: str) -> Panel:
        known, values = quantity(name), grid(self._table, name)
        if self._table["tick"][0].as_py() == 0:
            values[0] = np.nan  # nothing was reported yet
        values[grid(self._table, "status") == Status.LOST] = np.nan  # who is lost reports nothing
        label = plotstyle.axis(name)
        if known.logarithmic:
            return Panel(f"{known.name}, mean", label, partial(self._size, np.abs(values)))
        return Panel(f"{known.name}: mean, max, min", label, partial(self._span, values, from_zero=False))

    def _span(self, values: Floats, ax: Axes, from_zero: bool = True) -> None:
        rows = values[:: self._step]
        mean, low, high = span_where(rows, np.isfinite(rows)).T
        ax.fill_between(self._times, low, high, color=self._tone, alpha=0.18, linewidth=0)
        ax.plot(self._times, mean, color=self._tone)
        if from_zero:
            ax.set_ylim(bottom=0.0)
        elif not np.nan_to_num(rows).any():  # else the axis has ticks of ±0.04 about nothing
            ax.set_ylim(0.0, 1.0)

    def _size(self, sizes: Floats, ax: Axes) -> None:
        rows = sizes[:: self._step]
        mean = span_where(rows, np.isfinite(rows))[:, 0]
        if np.nanmax(mean, initial=0.0) > 0:
            ax.plot(self._times, np.where(mean > 0, mean, np.nan), color=self._tone, linewidth=1.0)
            plotstyle.log_axis(ax)
        else:
            ax.annotate("the residual is zero", (0.5, 0.5), xycoords="axes fraction", ha="center")
            ax.set_yticks([])

    def _line(self, ax: Axes, column: str, **look: Any) -> None:
        if column in self._table.column_names:  # a run of before need not have all
            ax.plot(self._times, line(self._table, column)[:: self._step], **{"color": self._tone, **look})

    def _bits(self, ax: Axes) -> None:
        sent = [column for name in TRAFFIC.values() if (column := f"{name}_bits") in self._table.column_names]
        ax.plot(self._times, sum(line(self._table, column)[:: self._step] for column in sent), color=self._tone)
        ax.set_ylim(bottom=0.0)
        plotstyle.bit_axis(ax.yaxis)

    def _alignment(self, ax: Axes) -> None:
        self._line(ax, "phi_A")
        ax.set_ylim(bottom=0.0)

    def _risk(self, ax: Axes) -> None:
        self._line(ax, "phi_C", label="with self-pairs")
        self._line(ax, "phi_C_distinct", label="distinct pairs", linestyle="--")
        _legend(ax)

    def _arrived(self, ax: Axes) -> None:
        self._line(ax, "arrived", label=f"arrived, of {self._uavs}")
        self._line(ax, "collisions", label=f"collisions ({FIELDS['collisions'].unit})", color=COLLISION, linewidth=1.0)
        _legend(ax)

    def _spread(self, ax: Axes) -> None:
        spread = line(self._table, "weight_spread")
        known = np.isfinite(spread)
        ax.plot(line(self._table, "sim_time_s")[known], spread[known], color=self._tone)
        ax.set_ylim(bottom=0.0)


COLLISION = plotstyle.STAR["color"]


def _ranged(field: str) -> str:
    return f"{FIELDS[field].name}: mean, max, min"


def _legend(ax: Axes) -> None:
    """The lines' names, with room for them above the lines."""
    ax.set_ylim(0.0, 1.3 * ax.dataLim.y1 if ax.dataLim.y1 > 0 else 1.0)
    ax.legend(loc="upper left", fontsize=7, ncols=2, borderaxespad=0.2)
