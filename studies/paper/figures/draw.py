"""The paper's figures 2 to 8, redrawn from our tables."""

from collections.abc import Callable, Iterable
from pathlib import Path

from matplotlib.figure import Figure

from meanflock.groundstation.plots import plotstyle
from meanflock.studies.paper.figures.curves import residuals, six_panels
from meanflock.studies.paper.figures.grids import against_period, against_uavs, against_wind
from meanflock.studies.paper.figures.paths import offline, trajectories
from meanflock.studies.paper.figures.regime_map import regime_map
from meanflock.studies.paper.tables import Results
from meanflock.studies.paper.view import View
from meanflock.swarm.errors import BadInput

_GRID = "; mean over seeds with 95 % interval. Dotted in (d): the floor 1/N of φ_C."

FIGURES: dict[str, tuple[Callable[[View], Figure | None], str]] = {
    "fig2": (
        trajectories,
        "One S0 run a method (seed 1), UAVs coloured by φ_G among the true states; stars are collisions, the square is "
        "the start, the ring the destination. Right: the 54 weights ŵ_H1 of UAV 0; ticks above mark the rounds.",
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
        "A programmed swarm without and with random wind, and one trained at σ = 0.1 that flies at σ = 1.5 (seed 1 "
        "each); stars are collisions.",
    ),
    "map": (
        regime_map,
        "Every setting of the designed search: how many of the claims about motion hold in its flights. Crosses: half "
        "or more of the UAVs never arrive. Rings: the three scenarios.",
    ),
}


def titled(name: str) -> str:
    """`Figure 3`, or `Map`."""
    return f"Figure {name.removeprefix('fig')}" if name.startswith("fig") else name.capitalize()


def chosen(only: Iterable[str]) -> list[str]:
    """Figures by name, as in `FIGURES`, or by number; all where none is named.

    Raises:
        BadInput: a figure that does not exist was asked for.
    """
    names = [asked if asked in FIGURES else f"fig{asked.removeprefix('fig')}" for asked in only]
    if unknown := sorted(set(names) - set(FIGURES)):
        raise BadInput(f"--only {', '.join(unknown)}: no such figure; there are {', '.join(FIGURES)}")
    return [name for name in FIGURES if name in names or not names]


def draw(results: Results, out: Path, only: Iterable[str] = ()) -> list[Path]:
    """Writes the figures into `out` as PNG and SVG; one whose data are not there is left out.

    Args:
        only: see `chosen`.
    """
    view = View.of(results)
    paths: list[Path] = []
    for name in chosen(only):
        with plotstyle.style():
            made = FIGURES[name][0](view)
        if made is not None:
            paths += plotstyle.save(made, out, name)
    return paths
