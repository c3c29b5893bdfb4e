"""The map of regimes: how many claims hold in every setting of the designed search."""

from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import NullLocator

from meanflock.groundstation.plots import plotstyle
from meanflock.studies.paper import regimes
from meanflock.studies.paper.regimes import Place
from meanflock.studies.paper.view import View

NO_CROSS_TERM = 2.5e-4  # where κ = 0 is drawn
_TICKS = {NO_CROSS_TERM: "0", 1e-3: "0.001", 1e-2: "0.01", 1e-1: "0.1"}


def regime_map(view: View) -> Figure | None:
    """Score over κ and L_v, a panel for either form of the polynomial; rings: the scenarios that have a name."""
    found = regimes.places(view)
    if not found:
        return None
    made = plotstyle.figure(plotstyle.COLUMN_IN, 3.4)
    axes = made.subplots(1, 2, sharey=True)
    most = max(place.score for place in found)
    named = [(next(p for p in found if not p.setting), "paper")] if any(not p.setting for p in found) else []
    named += [
        (choose(found), name) for choose, name in ((regimes.slow, "paper-slow"), (regimes.printed, "paper-printed"))
    ]
    for letter, ax, multinomial in zip("ab", axes, (False, True), strict=True):
        own = sorted((p for p in found if p.multinomial is multinomial), key=lambda place: place.score)
        gone = [p for p in own if p.never_arrived >= regimes.FEW_ARRIVE]
        kept = [p for p in own if p.never_arrived < regimes.FEW_ARRIVE]
        ax.scatter(*_where(gone), s=12, marker="x", color=plotstyle.PALE, linewidths=0.8, zorder=1)
        shown = ax.scatter(*_where(kept), c=[p.score for p in kept], s=22, cmap="viridis", vmin=0, vmax=most, zorder=2)
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
    made.colorbar(shown, ax=axes, label=f"claims that hold (of {len(found[0].held)})", fraction=0.04)
    return made


def _where(places: list[Place]) -> tuple[list[float], list[float]]:
    """κ and L_v of settings."""
    return (
        [place.key("learner.kappa", 0.01) or NO_CROSS_TERM for place in places],
        [place.key("learner.velocity_scale", 20.0) for place in places],
    )
