"""Figures 2 and 8: paths of the UAVs."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from meanflock.federation.plan import plan_of
from meanflock.kernels.mean_field import layout
from meanflock.results.plots import plotstyle
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import Status
from research.reproduction.curves import COMPARED
from research.reproduction.tables import View
from research.reproduction.traces import Trace, collisions, interaction_term, trace

Floats = NDArray[np.float64]

SNAPSHOTS_S = (40.0, 125.0)
_EVERY = 5  # samples of a trace from one drawn point to the next: 1 s
_SEPARATED = "start.spacing=6"


def _marks(ax: Axes, flown: Trace) -> None:
    """Start square, destination ring, axes in metres with one scale."""
    start = state.position(flown.states[0])
    low, high = start.min(axis=0) - 2.0, start.max(axis=0) + 2.0
    ax.add_patch(
        Rectangle((low[0], low[1]), *(high - low), fill=False, edgecolor=plotstyle.INK, linewidth=0.9, zorder=4)
    )
    radius = Scenario().destination.radius
    ax.add_patch(Circle((0.0, 0.0), radius, fill=False, edgecolor=plotstyle.INK, linewidth=1.1, zorder=4))
    ax.set_aspect("equal", adjustable="box")
    ax.grid(visible=False)


def _stars(ax: Axes, met: Floats) -> None:
    """A star at every collision, rows (t, x, y)."""
    ax.plot(met[:, 1], met[:, 2], **plotstyle.STAR, zorder=5)


def _paths(ax: Axes, position: Floats, colour: str | Floats, width: float = 0.7) -> None:
    """Draw paths with a dot at the last position of each UAV."""
    plotstyle.paths(ax, position, colour, width)
    last = position[-1]
    ax.plot(last[:, 0], last[:, 1], linestyle="", marker="o", markersize=1.8, color=plotstyle.INK, markeredgewidth=0)


def _box(flights: list[Trace]) -> tuple[Floats, Floats]:
    """Corners of a box around starts, destination and 99.6 % of all positions, with a margin."""
    corners = [np.full((1, 2), -8.0), np.full((1, 2), 8.0)]
    for flown in flights:
        position = state.position(flown.states)
        corners.append(position[0] + 4.0)
        corners.append(position[0] - 4.0)
        corners.append(np.nanpercentile(position.reshape(-1, 2), (0.2, 99.8), axis=0))
    points = np.concatenate(corners)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.03 * float((high - low).max())
    return low - margin, high + margin


def trajectories(view: View) -> Figure | None:
    """Figure 2: for each method the flight at two instants, the whole trip, and the value weights of UAV 0."""
    flights = {method: trace(view, "s0", method) for method in COMPARED}
    trips = {method: flown.until(flown.mission_s) for method, flown in flights.items() if flown is not None}
    if not trips:
        return None
    low, high = _box(list(trips.values()))
    figure = plotstyle.figure(8.6, 1.62 * len(trips) + 0.75)
    grid = figure.subplots(len(trips), 4, width_ratios=[1.0, 1.0, 1.0, 1.05], squeeze=False)
    for row, (method, trip) in enumerate(trips.items()):
        met = collisions(trip)
        drawn = Trace(trip.times[::_EVERY], trip.states[::_EVERY], trip.status[::_EVERY])
        shade = interaction_term(drawn)
        last = row == len(trips) - 1
        for ax, until in zip(grid[row], (*SNAPSHOTS_S, trip.times[-1]), strict=False):
            part = drawn.until(until)
            _paths(ax, state.position(part.states), shade[: len(part.times)])
            _marks(ax, part)
            so_far = met[met[:, 0] <= until]
            _stars(ax, so_far)
            ax.set_xlim(low[0], high[0])
            ax.set_ylim(low[1], high[1])
            ax.set_title(f"{until:.0f} s, {len(so_far)} collisions", loc="left", fontsize=8, pad=3)
            ax.tick_params(labelleft=ax is grid[row, 0], labelbottom=last)
            if last:
                ax.set_xlabel("$x$ (m)")
        grid[row, 0].set_ylabel(plotstyle.name(method), color=plotstyle.colour(method), fontsize=10, fontweight="bold")
        grid[row, 0].annotate("$y$ (m)", (0, 1), xycoords="axes fraction", xytext=(3, -9), textcoords="offset points")
        _weights(grid[row, -1], view, method)
        grid[row, -1].tick_params(labelbottom=last)
    grid[-1, -1].set_xlabel(plotstyle.axis("t_s"))
    grid[0, -1].set_title(r"value weights $\hat w_{H1}$ of UAV 0 (m/s)", loc="left", fontsize=8, pad=3)
    bar = figure.colorbar(
        ScalarMappable(**plotstyle.PHI_G),
        ax=grid[:, :-1],
        location="top",
        shrink=0.5,
        aspect=45,
        extend="both",
        pad=0.012,
    )
    bar.set_label(r"interaction term $\phi_G$ of a UAV (1/s$^2$)")
    return figure


def _weights(ax: Axes, view: View, method: str) -> None:
    """ŵ_H1 of UAV 0, the weights the paper plots; ticks above where rounds open."""
    if not len(view.weights):
        return
    frame = view.weights.where(experiment="s0", method=method)
    if not len(frame):
        return
    order = np.argsort(frame["t_s"])
    times, models = frame["t_s"][order], frame["model"][order]
    block = models[:, layout.VALUE.start + layout.VALUE_FEATURES : layout.VALUE.stop]
    ax.plot(times, block, linewidth=0.6, color=plotstyle.colour(method), alpha=0.8)
    scenario = load(None, method=method)
    if plan_of(scenario).declared.is_federated:
        rounds = np.arange(1, int(times.max() / scenario.dt) // scenario.period_ticks + 1) * scenario.period_ticks
        ax.plot(
            rounds * scenario.dt,
            np.full(len(rounds), 0.985),
            transform=ax.get_xaxis_transform(),
            linestyle="",
            marker="|",
            markersize=4,
            color=plotstyle.INK,
        )
    ax.margins(x=0.0)


def offline(view: View) -> Figure | None:
    """Figure 8: programmed without wind noise, with it, and a trained swarm in a strong wind."""
    wanted: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
        ("programmed, no noise", "offline", "offline", {"sigma": 0.0, "setting": _SEPARATED}),
        ("programmed, $\\sigma$ = 0.1", "offline", "offline", {"sigma": 0.1, "setting": _SEPARATED}),
        ("trained, $\\sigma$ = 1.5", "trained", "mfgfl-hf", {"trained": True}),
    )
    flights = [(title, method, trace(view, experiment, method, **where)) for title, experiment, method, where in wanted]
    panels = [(title, method, flown.until(flown.mission_s)) for title, method, flown in flights if flown is not None]
    if not panels:
        return None
    low, high = _box([flown for _, _, flown in panels])
    figure = plotstyle.figure(plotstyle.PAGE_IN, 2.75)
    axes = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    for letter, ax, (title, method, flown) in zip("abc", axes, panels, strict=False):
        _paths(ax, state.position(flown.states), plotstyle.colour(method), 0.8)
        _marks(ax, flown)
        met = collisions(flown)
        _stars(ax, met)
        ax.set_xlim(low[0], high[0])
        ax.set_ylim(low[1], high[1])
        arrived = int((flown.status[-1] == Status.ARRIVED).sum())
        caption = f"{arrived} of {flown.states.shape[1]} arrived, {len(met)} collisions"
        plotstyle.titled(ax, letter, f"{title}\n{caption}")
        ax.set_xlabel("$x$ (m)")
    axes[0].set_ylabel("$y$ (m)")
    star = Line2D([], [], linestyle="", marker="*", markersize=7, color="#CC2222", label="collision")
    plotstyle.legend(figure, list(dict.fromkeys(method for _, method, _ in panels)), extra=[star])
    return figure
