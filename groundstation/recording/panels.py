"""The plots of a recording over time: those of every flight, and one for whatever the controller reports."""

from dataclasses import dataclass

from meanflock.channel.meter import TRAFFIC
from meanflock.groundstation import quantities
from meanflock.groundstation.recording.palette import BLUE, COLLISION, GREEN, GREY, ORANGE, RED, VIOLET, WHITE
from meanflock.groundstation.reported import PHI_G, Reported

PLOTS = "plots"
HITS = "plots/risk/hits"


@dataclass(frozen=True)
class Plot:
    """A time series view: one entity of scalars, a column a line."""

    entity: str
    title: str  # with the unit
    names: tuple[str, ...]
    colors: tuple[int, ...]
    widths: tuple[float, ...] = ()
    legend: bool = False  # only where the lines stay out of the upper left corner, as sums do
    log10: bool = False  # of the lines' values


_RANGE = ("mean", "min", "max")
_RANGE_COLORS = (WHITE, BLUE, ORANGE)
_RANGE_WIDTHS = (2.5, 1.2, 1.2)
_SIZES, _SIZES_COLORS, _SIZES_WIDTHS = ("max", "mean"), (ORANGE, WHITE), (1.2, 2.5)

ENERGY = Plot("plots/energy", quantities.ENERGY.title(), _RANGE, _RANGE_COLORS, _RANGE_WIDTHS, True)
SPEED = Plot("plots/speed", quantities.SPEED.title("mean, min, max"), _RANGE, _RANGE_COLORS, _RANGE_WIDTHS)
BITS = Plot(
    "plots/bits",
    f"{quantities.PAYLOAD.name}, Mbit",
    tuple(TRAFFIC.values()),
    (BLUE, GREEN, ORANGE, VIOLET),
    legend=True,
)
LAST = ENERGY  # sent last, with a value in every tick: where it is in a file, all before it is, see `recorded`
ALIGNMENT = Plot("plots/alignment", quantities.ALIGNMENT.title(), ("φ_A",), (VIOLET,))
RISK = Plot(
    "plots/risk",
    f"{quantities.RISK_PRINTED.name}; grey: distinct pairs",
    ("with self-pairs", "distinct pairs"),
    (ORANGE, GREY),
)
FAILURES = Plot(
    "plots/failures",
    f"{quantities.OUTAGES.title()}; {quantities.COLLISIONS.title()}",
    ("outages", "collisions"),
    (RED, COLLISION),
    legend=True,
)
OF_EVERY_FLIGHT = (ENERGY, SPEED, BITS, FAILURES, ALIGNMENT, RISK)
SPREAD = Plot("plots/spread", quantities.SPREAD.title("RMS distance from their mean"), ("spread",), (VIOLET,))
WEIGHTS = "plots/weights"


def diagnostic(name: str) -> Plot:
    """The plot of a diagnostic: residuals by their sizes, whatever else by mean, minimum and maximum."""
    known = quantities.of(name)
    if name in quantities.RESIDUALS:
        title = f"{known.title()}; log10 of mean, max"
        return Plot(f"{PLOTS}/{name}", title, _SIZES, _SIZES_COLORS, _SIZES_WIDTHS, log10=True)
    entity = f"{PLOTS}/phi_g" if name == PHI_G else f"{PLOTS}/reported/{name}"
    return Plot(entity, known.title("mean, min, max"), _RANGE, _RANGE_COLORS, _RANGE_WIDTHS)


def weights_title(leader: int, reported: Reported) -> str:
    """What the lines of the weights' plot are."""
    drawn = len(reported.drawn)
    which = f"{drawn} of {reported.weights}" if drawn < reported.weights else f"all {drawn}"
    return f"what UAV {leader} has learned: {which} weights"
