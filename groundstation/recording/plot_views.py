"""The views of a recording's plots over time, as a blueprint arranges them."""

import rerun as rr
import rerun.blueprint as rrb

from meanflock.groundstation.recording import panels
from meanflock.groundstation.reported import Reported

_DETAILS = 3  # plots in a tab


def learned(leader: int, reported: Reported) -> tuple[list[rrb.View], list[rrb.View]]:
    """Plots of what the controller reports: at most two for the grid, the others for tabs beside it."""
    plots: list[rrb.View] = [series(panels.diagnostic(name)) for name in reported.diagnostics]
    if not reported.weights:
        return plots[:2], plots[2:]
    weights = rrb.TimeSeriesView(
        origin=f"/{panels.WEIGHTS}",
        name=panels.weights_title(leader, reported),
        axis_x=whole_flight(),
        plot_legend=rrb.PlotLegend(visible=False),
    )
    return [*plots[:1], weights], [*plots[1:], series(panels.SPREAD)]


def tabs(plots: list[rrb.View], name: str) -> list[rrb.Container]:
    """Plots below each other, as many to a tab as can be read."""
    groups = [plots[first : first + _DETAILS] for first in range(0, len(plots), _DETAILS)]
    return [
        rrb.Vertical(*group, name=name if len(groups) == 1 else f"{name} {number}")
        for number, group in enumerate(groups, 1)
    ]


def series(plot: panels.Plot) -> rrb.TimeSeriesView:
    """The view of a plot."""
    return rrb.TimeSeriesView(
        origin=f"/{plot.entity}",
        name=plot.title,
        axis_x=whole_flight(),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=plot.legend),
    )


def whole_flight() -> rrb.TimeAxis:
    """Without it a plot shows half a minute around the cursor."""
    return rrb.TimeAxis(
        link=rrb.components.LinkAxis.Independent,
        view_range=rr.TimeRange(rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.infinite()),
    )
