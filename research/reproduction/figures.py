"""The paper's figures 2 to 8, redrawn from our tables."""

from collections.abc import Callable, Iterable
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import NullLocator

from meanflock.results.plots import plotstyle
from meanflock.swarm.errors import BadInput, meant
from research.reproduction import regimes
from research.reproduction.curves import against_period, against_uavs, against_wind, residuals, six_panels
from research.reproduction.paths import offline, trajectories
from research.reproduction.regimes import MapPoint
from research.reproduction.tables import Results, View

# -- map of regimes ----------------------------------------------------------------------------------------------------


NO_CROSS_TERM = 2.5e-4  # where κ = 0 is drawn
_TICKS = {NO_CROSS_TERM: "0", 1e-3: "0.001", 1e-2: "0.01", 1e-1: "0.1"}


def regime_map(view: View) -> Figure | None:
    """Scores over κ and L_v, with a panel for each form of the polynomial; rings mark the named scenarios."""
    found = regimes.places(view)
    if not found:
        return None
    figure = plotstyle.figure(plotstyle.COLUMN_IN, 3.4)
    axes = figure.subplots(1, 2, sharey=True)
    most = max(place.score for place in found)
    named = [(next(p for p in found if not p.setting), "paper")] if any(not p.setting for p in found) else []
    named += [
        (choose(found), name) for choose, name in ((regimes.slow, "paper-slow"), (regimes.printed, "paper-printed"))
    ]
    for letter, ax, multinomial in zip("ab", axes, (False, True), strict=True):
        own = sorted((p for p in found if p.multinomial is multinomial), key=lambda place: place.score)
        absent = [p for p in own if p.never_arrived >= regimes.FEW_ARRIVE]
        scored = [p for p in own if p.never_arrived < regimes.FEW_ARRIVE]
        ax.scatter(*_where(absent), s=12, marker="x", color=plotstyle.PALE, linewidths=0.8, zorder=1)
        shown = ax.scatter(
            *_where(scored), c=[p.score for p in scored], s=22, cmap="viridis", vmin=0, vmax=most, zorder=2
        )
        for place, name in named:
            if place.multinomial is multinomial:
                x, y = _where([place])
                ax.scatter(x, y, s=90, facecolors="none", edgecolors="black", linewidths=1.2, zorder=3)
                ax.annotate(
                    name,
                    (x[0], y[0]),
                    xytext=(6, 6),
                    textcoords="offset points",
                    ha="left",
                    fontsize=7,
                    zorder=4,
                    path_effects=[withStroke(linewidth=2.0, foreground="white")],  # hides no point
                )
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xticks(list(_TICKS), list(_TICKS.values()))
        ax.set_yticks([10, 20, 50, 100, 150], ["10", "20", "50", "100", "150"])
        ax.xaxis.set_minor_locator(NullLocator())
        ax.yaxis.set_minor_locator(NullLocator())
        ax.set_xlabel("$\\kappa$ (1/s)")
        plotstyle.titled(ax, letter, "multinomial coefficients" if multinomial else "all coefficients 1")
    axes[0].set_ylabel("velocity scale $L_v$ (m/s)")
    figure.colorbar(shown, ax=axes, label=f"claims that hold (of {len(found[0].held)})", fraction=0.04)
    return figure


def _where(places: list[MapPoint]) -> tuple[list[float], list[float]]:
    """κ and L_v of settings."""
    return (
        [place.key("learner.kappa", 0.01) or NO_CROSS_TERM for place in places],
        [place.key("learner.velocity_scale", 20.0) for place in places],
    )


# -- all figures -------------------------------------------------------------------------------------------------------


_GRID = "; mean over seeds with 95 % interval. Dotted in (d): the floor 1/N of φ_C."

FIGURES: dict[str, tuple[Callable[[View], Figure | None], str]] = {
    "fig2": (
        trajectories,
        "One S0 run a method (first seed), UAVs coloured by φ_G among the true states; stars are collisions, the "
        "square is the start, the ring the destination. Right: the 54 weights ŵ_H1 of UAV 0; ticks above mark the "
        "rounds.",
    ),
    "fig3": (
        six_panels,
        "S0 over time. (a) Energy until own arrival: mean and, shaded, ± one standard deviation over UAVs, both "
        "averaged over seeds. (b, c, d, f) Mean over seeds with 95 % interval. (e) Mean speed of all UAVs; thin: the "
        "fastest and the slowest. The dotted line is the paper's 175 s.",
    ),
    "fig4": (
        residuals,
        "Residuals of the two learners in S0: mean over UAVs (thick) and largest of any UAV (thin), averaged over "
        "seeds. The dotted line is the paper's bound.",
    ),
    "fig5": (against_uavs, "Against the size of the swarm" + _GRID),
    "fig6": (against_period, "Against the length of a round" + _GRID),
    "fig7": (against_wind, "Against the strength of the wind" + _GRID),
    "fig8": (
        offline,
        "A programmed swarm without and with random wind, and one trained at σ = 0.1 that flies at σ = 1.5 (first "
        "seed each); stars are collisions.",
    ),
    "map": (
        regime_map,
        "Every setting of the designed search: how many of the claims about motion hold in its flights. Crosses: half "
        "or more of the UAVs never arrive. Rings: the three scenarios.",
    ),
}

# The experiments that a figure shows.
FLOWN_FOR: dict[str, set[str]] = {
    "fig2": {"s0"},
    "fig3": {"s0"},
    "fig4": {"s0"},
    "fig5": {"uavs"},
    "fig6": {"period"},
    "fig7": {"wind"},
    "fig8": {"offline", "trained"},
    "map": {"map", "found"},
    # and those without a figure, of the tables of docs/reproduction.md
    "exchanged": {"exchanged", "exchanged-map", "common", "held-back", "drift", "density", "losses"},
}


def titled(name: str) -> str:
    """`Figure 3`, or `Map`."""
    return f"Figure {name.removeprefix('fig')}" if name.startswith("fig") else name.capitalize()


def chosen(only: Iterable[str]) -> list[str]:
    """Names in `FLOWN_FOR`, asked for by name or number of the figure; all if `only` is empty.

    Raises:
        BadInput: a figure that does not exist was asked for.
    """
    names = [asked if asked in FLOWN_FOR else f"fig{asked.removeprefix('fig')}" for asked in only]
    if unknown := sorted(set(names) - set(FLOWN_FOR)):
        there_are = f"there are {', '.join(FLOWN_FOR)}"
        raise BadInput(f"--only {', '.join(unknown)}: no such figure{meant(unknown[0], FLOWN_FOR)}; {there_are}")
    return [name for name in FLOWN_FOR if name in names or not names]


def draw(results: Results, out: Path, only: Iterable[str] = ()) -> list[Path]:
    """Write the figures into `out` as PNG and SVG; leave out a figure without data.

    Args:
        only: see `chosen`.
    """
    view = View.from_results(results)
    paths: list[Path] = []
    for name in (name for name in chosen(only) if name in FIGURES):
        with plotstyle.style():
            figure = FIGURES[name][0](view)
        if figure is not None:
            paths += plotstyle.save(figure, out, name)
    return paths
