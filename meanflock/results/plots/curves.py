"""The curves of a run: a panel for each quantity of its time series, in the colours of the groups."""

from collections.abc import Callable
from functools import partial, reduce
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from meanflock.channel.meter import TRAFFIC
from meanflock.results.plots import plotstyle
from meanflock.results.plots.run_picture import RunPicture, parts_of
from meanflock.results.quantities import FIELDS, POSITION, RISK, VELOCITY, quantity
from meanflock.results.series import diagnostics_in, dimensions_in, span_where
from meanflock.swarm import mission, state
from meanflock.swarm.wire.messages import Status

Floats = NDArray[np.float64]

MAX_POINTS = 1500  # of a curve, or instants of a path


@plotstyle.style()
def plot_curves(run: RunPicture) -> Figure:
    """A panel for each quantity that changes from zero in the flight; a caption names the others."""
    parts = parts_of(run.scenario)
    every = _Panels(run).all()
    panels = [panel for panel in every if panel.varies]
    rows = -(-len(panels) // 2)
    figure = plotstyle.figure(plotstyle.PAGE_IN, 1.9 * rows)
    axes = figure.subplots(rows, 2, sharex=True, squeeze=False)
    for number, (panel, ax) in enumerate(zip(panels, axes.ravel(), strict=False)):
        panel.draw(ax)
        plotstyle.titled(ax, plotstyle.letter(number), panel.title)
        ax.set_ylabel(panel.label)
        ax.margins(x=0.0)
    if len(panels) < axes.size:
        axes[-1, -1].set_visible(False)
        axes[-2, -1].xaxis.set_tick_params(labelbottom=True)
        axes[-2, -1].set_xlabel(plotstyle.axis("t_s"))
    for ax in axes[-1]:
        ax.set_xlabel(plotstyle.axis("t_s"))
    if zero := [panel.name for panel in every if not panel.varies]:
        plotstyle.captioned(figure, f"zero throughout the flight: {'; '.join(zero)}")
    if len(parts) > 1:
        handles = [Line2D([], [], color=part.colour, linestyle=part.dash, label=part.name) for part in parts]
        handles.append(Line2D([], [], color=plotstyle.INK, label="all UAVs"))
        plotstyle.place_legend(figure, handles)
    return figure


class _Panel(NamedTuple):
    """A plot over time.

    lines: what its lines are. label: of its y axis. varies: whether it is ever not 0. remark: of its title.
    """

    name: str
    lines: str
    label: str
    draw: Callable[[Axes], None]
    varies: bool = True
    remark: str = ""

    @property
    def title(self) -> str:
        """Name, remark and lines."""
        named = f"{self.name}, {self.remark}" if self.remark else self.name
        return f"{named}: {self.lines}" if self.lines else named


class _Panels:
    """The panels of a time series."""

    def __init__(self, run: RunPicture) -> None:
        self._run, self._parts = run, parts_of(run.scenario)
        self._tone = self._parts[0].colour if len(self._parts) == 1 else plotstyle.INK  # of lines of the swarm
        self._status = run.grid("status")
        self._step = max(1, run.table.num_rows // MAX_POINTS)
        self._times = run.line("sim_time_s")[:: self._step]
        self._bits = np.sum([run.line(f"{name}_bits") for name in TRAFFIC.values()], axis=0)

    def all(self) -> list[_Panel]:
        """The panels of every flight, then those of the reports of controllers, filters, learners and vehicles."""
        run, schema = self._run, self._run.table.schema
        axes = dimensions_in(schema)
        speed = reduce(np.hypot, (run.grid(name) for name in VELOCITY[:axes]))
        panels = [
            self._ranged("energy_J", run.grid("energy_J")),
            self._ranged("speed_mean_m_s", speed),
            self._swarm("payload_bits.total", self._draw_bits, self._bits),
            self._swarm("phi_A", self._draw_alignment, run.line("phi_A")),
            self._swarm("phi_C", self._draw_risk, run.line("phi_C_distinct"))._replace(
                name="collision risk φ_C" if run.line("phi_C_distinct").any() else RISK.name
            ),
            self._swarm("arrived", self._draw_arrived, run.line("arrived")),
            self._swarm("collisions", self._draw_collisions, run.line("collisions")),
            *map(self._diagnostic, diagnostics_in(schema)),
        ]
        if axes == state.SPACE:
            height = partial(self._draw_span, run.grid(POSITION[-1]))
            panels.insert(2, _Panel("altitude", "mean, max, min", "$z$ (m)", height))
        if run.table["weight_spread"].null_count < run.table.num_rows:
            panels.append(self._swarm("weight_spread", self._draw_spread, run.line("weight_spread")))
        return panels

    def _ranged(self, field: str, values: Floats) -> _Panel:
        """A panel of a quantity that each UAV has, (T, N)."""
        draw = partial(self._draw_span, values)
        return _Panel(FIELDS[field].name, "mean, max, min", plotstyle.axis(field), draw)

    def _swarm(self, field: str, draw: Callable[[Axes], None], values: Floats) -> _Panel:
        """A panel of a quantity of the swarm, (T,)."""
        measured, varies = FIELDS[field], bool(np.nan_to_num(values).any())
        return _Panel(measured.name, "", plotstyle.axis(field), draw, varies, measured.remark)

    def _diagnostic(self, name: str) -> _Panel:
        measured, values = quantity(name), self._run.grid(name)
        values[self._status >= Status.LOST] = np.nan  # a UAV that is lost or landed reports nothing
        joins = mission.joins(self._run.scenario)
        values[self._run.line("tick")[:, None] <= joins] = np.nan  # nor does one before its first tick
        label, varies = plotstyle.axis(name), bool(np.nan_to_num(values).any())
        if measured.logarithmic:
            draw = partial(self._draw_mean, np.abs(values), is_logarithmic=True)
            return _Panel(measured.name, "mean", label, draw, varies)
        if measured.share:
            return _Panel(measured.name, "", label, partial(self._draw_mean, values), varies)
        draw = partial(self._draw_span, values, from_zero=False)
        return _Panel(measured.name, "mean, max, min", label, draw, varies)

    def _draw_span(self, values: Floats, ax: Axes, from_zero: bool = True) -> None:
        rows = values[:: self._step]
        for part in self._parts:
            own = rows[:, part.rows]
            mean, low, high = span_where(own, np.isfinite(own)).T
            ax.fill_between(self._times, low, high, color=part.colour, alpha=0.18, linewidth=0)
            ax.plot(self._times, mean, color=part.colour, linestyle=part.dash)
        if from_zero:
            ax.set_ylim(bottom=0.0)

    def _draw_mean(self, values: Floats, ax: Axes, is_logarithmic: bool = False) -> None:
        """Draws the mean of each group, with gaps where none of its UAVs has the number."""
        rows = values[:: self._step]
        for part in self._parts:
            own = rows[:, part.rows]
            mean = span_where(own, np.isfinite(own))[:, 0]
            shown = np.where(mean > 0, mean, np.nan) if is_logarithmic else mean
            ax.plot(self._times, shown, color=part.colour, linestyle=part.dash, linewidth=1.0)
        if is_logarithmic:
            plotstyle.log_axis(ax)
        else:
            ax.set_ylim(bottom=0.0)

    def _plot(self, ax: Axes, values: Floats, **look: Any) -> None:
        ax.plot(self._times, values[:: self._step], **{"color": self._tone, **look})
        ax.set_ylim(bottom=0.0)

    def _draw_bits(self, ax: Axes) -> None:
        self._plot(ax, self._bits)
        plotstyle.bit_axis(ax.yaxis)

    def _draw_alignment(self, ax: Axes) -> None:
        self._plot(ax, self._run.line("phi_A"))

    def _draw_risk(self, ax: Axes) -> None:
        self._plot(ax, self._run.line("phi_C"), label="with self-pairs")
        self._plot(ax, self._run.line("phi_C_distinct"), label="distinct pairs", linestyle="--")
        ax.set_ylim(0.0, 1.3 * ax.dataLim.y1)  # room for the legend
        ax.legend(loc="upper left", fontsize=7, ncols=2, borderaxespad=0.2)

    def _draw_arrived(self, ax: Axes) -> None:
        arrived = np.logical_or.accumulate(self._status == Status.ARRIVED, axis=0)
        for part in self._parts:
            counted = arrived[:: self._step, part.rows].sum(axis=1)
            ax.plot(self._times, counted, color=part.colour, linestyle=part.dash)
        ax.set_ylim(bottom=0.0)
        ax.yaxis.set_major_locator(MaxNLocator(6, integer=True))

    def _draw_collisions(self, ax: Axes) -> None:
        self._plot(ax, self._run.line("collisions"))
        ax.yaxis.set_major_locator(MaxNLocator(6, integer=True))

    def _draw_spread(self, ax: Axes) -> None:
        spread = self._run.line("weight_spread")
        reported = np.isfinite(spread)
        ax.plot(self._run.line("sim_time_s")[reported], spread[reported], color=self._tone)
        ax.set_ylim(bottom=0.0)
