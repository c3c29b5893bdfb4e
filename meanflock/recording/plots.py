"""The plots of a recording over time: titles, lines and colours, and the values of the lines out of telemetry."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.meter import TRAFFIC
from meanflock.recording.drawing import (
    BLUE,
    COLLISION,
    GREEN,
    GREY,
    ORANGE,
    RED,
    VIOLET,
    WHITE,
    Floats,
    Sent,
    Ticks,
    group_color,
    scalars,
)
from meanflock.results import quantities
from meanflock.results.series import BITS_SENT, COLUMN, Reported, log_sizes, span, span_where
from meanflock.swarm import state
from meanflock.swarm.events import RoundEnded
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status, Telemetry

PLOTS = "plots"
HITS = "plots/risk/hits"
WEIGHTS = "plots/weights"


@dataclass(frozen=True)
class Plot:
    """A time series view: one entity of scalars, a column a line.

    title: with the unit. legend: shown in the upper left corner, which lines that grow leave free. log10: whether the
    lines are logarithms of the values.
    """

    entity: str
    title: str
    names: tuple[str, ...]
    colors: tuple[int, ...]
    widths: tuple[float, ...] = ()
    legend: bool = False
    log10: bool = False


_RANGE = ("mean", "min", "max")
_RANGE_COLORS = (WHITE, BLUE, ORANGE)
_RANGE_WIDTHS = (2.5, 1.2, 1.2)
_SIZES = ("max", "mean")
_SIZES_COLORS = (ORANGE, WHITE)
_SIZES_WIDTHS = (1.2, 2.5)

ENERGY = Plot("plots/energy", quantities.ENERGY.title(), _RANGE, _RANGE_COLORS, _RANGE_WIDTHS, True)
SPEED = Plot("plots/speed", quantities.SPEED.title("mean, min, max"), _RANGE, _RANGE_COLORS, _RANGE_WIDTHS)
ALTITUDE = Plot("plots/altitude", "altitude, m: mean, min, max", _RANGE, _RANGE_COLORS, _RANGE_WIDTHS)  # in space
ARRIVED = Plot("plots/arrived", "arrived and in the air, UAVs", ("arrived",), (GREEN,))  # with groups
BITS = Plot(
    "plots/bits",
    f"{quantities.PAYLOAD.name}, Mbit",
    tuple(TRAFFIC.values()),
    (BLUE, GREEN, ORANGE, VIOLET),
    legend=True,
)
LAST = ENERGY  # sent last, in every tick: a file that has it for a tick has all of that tick
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
IN_SPACE = (*OF_EVERY_FLIGHT[:2], ALTITUDE, *OF_EVERY_FLIGHT[2:])
ROUNDS = Plot(
    "plots/rounds",
    "rounds: uploads received in time, late; participants silent",
    ("received, %", "late, %", "silent, %"),
    (GREEN, ORANGE, GREY),
    legend=True,
)
SPREAD = Plot("plots/spread", quantities.SPREAD.title("RMS distance from their mean"), ("spread",), (VIOLET,))


def diagnostic(name: str) -> Plot:
    """The plot of a diagnostic: of a residual the logarithm of its size, else mean, minimum and maximum."""
    quantity = quantities.quantity(name)
    if quantity.logarithmic:
        title = f"{quantity.title()}; log10 of mean, max"
        return Plot(f"{PLOTS}/{name}", title, _SIZES, _SIZES_COLORS, _SIZES_WIDTHS, log10=True)
    entity = f"{PLOTS}/phi_g" if name == quantities.PHI_G else f"{PLOTS}/reported/{name}"
    return Plot(entity, quantity.title("mean, min, max"), _RANGE, _RANGE_COLORS, _RANGE_WIDTHS)


def weights_title(leader: int, reported: Reported) -> str:
    """The title of the plot of the leader's weights."""
    drawn = len(reported.drawn)
    which = f"{drawn} of {reported.weights}" if drawn < reported.weights else f"all {drawn}"
    return f"what UAV {leader} has learned: {which} weights"


def of_flight(scenario: Scenario) -> tuple[Plot, ...]:
    """The plots of a flight; with groups, those of numbers of UAVs have a line a group."""
    found = IN_SPACE if scenario.space.dimensions == state.SPACE else OF_EVERY_FLIGHT
    if not scenario.groups:
        return found
    return (
        *(_by_group(plot, scenario) if plot in (ENERGY, SPEED, ALTITUDE) else plot for plot in found),
        replace(_by_group(ARRIVED, scenario), title=ARRIVED.title),
    )


def _by_group(plot: Plot, scenario: Scenario) -> Plot:
    """The plot with the mean of each group, in its colour."""
    count = len(scenario.groups)
    return replace(
        plot,
        title=f"{plot.title.partition(':')[0]}: mean of each group",
        names=tuple(group.name for group in scenario.groups),
        colors=tuple(map(group_color, range(count))),
        widths=(2.0,) * count,
    )


def plot_rows(
    ticks: Ticks,
    states: state.States,
    diagnostics: Floats,
    swarm: NDArray[np.float64],
    energy: Floats,
    status: NDArray[np.uint8],
    names: Sequence[str],
    computed: NDArray[np.bool_] | None = None,
    groups: Sequence[slice] = (),
) -> Iterator[Sent]:
    """Values of all plots at ticks (T,), those of `LAST` at the end.

    Args:
        states: (T, N, 2d). diagnostics: (T, N, K), called `names`. swarm: (T, columns), as in `SWARM_COLUMNS`.
        energy: (T, N), J. status: (T, N). computed: diagnostics that UAVs had in these ticks, (T, N, K), as far as
            they are not lost; None: all. groups: the UAVs of each group; empty without groups.
    """

    def columns(*names: str) -> NDArray[np.float64]:
        return swarm[:, [COLUMN[name] for name in names]]

    def lines(values: NDArray[Any]) -> NDArray[np.float64]:
        """The mean of each group, (T, groups); without groups mean, minimum and maximum, (T, 3)."""
        means = [values[:, own].mean(axis=1, dtype=np.float64) for own in groups]
        return np.stack(means, axis=-1) if means else span(values)

    yield from scalars(SPEED.entity, ticks, lines(state.speed(states)))
    if state.axes(states) == state.SPACE:
        yield from scalars(ALTITUDE.entity, ticks, lines(state.position(states)[..., 2]))
    if groups:
        arrived = np.stack([(status[:, own] == Status.ARRIVED).sum(axis=1) for own in groups], axis=-1)
        yield from scalars(ARRIVED.entity, ticks, arrived)
    yield from scalars(BITS.entity, ticks, swarm[:, BITS_SENT] / 1e6)
    yield from scalars(ALIGNMENT.entity, ticks, columns("phi_A"))
    yield from scalars(RISK.entity, ticks, columns("phi_C", "phi_C_distinct"))
    yield from scalars(FAILURES.entity, ticks, columns("outages", "collisions"))
    for number, name in enumerate(names):
        active = status < Status.LOST if computed is None else (status < Status.LOST) & computed[..., number]
        yield from _diagnostic_rows(diagnostic(name), ticks, diagnostics[..., number], active)
    yield from scalars(LAST.entity, ticks, lines(energy))


def _diagnostic_rows(plot: Plot, ticks: Ticks, values: NDArray[Any], active: NDArray[np.bool_]) -> Iterator[Sent]:
    """Values of a diagnostic over the UAVs `active` (T, N), which have it and fly; none at take-off."""
    if plot.log10:
        computed, lines = log_sizes(values)
        yield from scalars(plot.entity, ticks if computed.all() else ticks[computed], lines)
    else:
        flown = active.any(axis=1) & (ticks > 0)
        yield from scalars(plot.entity, ticks[flown], span_where(values[flown], active[flown]))


def percentages(rounds: Sequence[RoundEnded]) -> NDArray[np.float64]:
    """The lines of `ROUNDS`, (R, 3), NaN where there is nothing to share."""
    lines = []
    for each in rounds:
        sent = len(each.sent)
        arrived, copies = (each.arrived, each.copies) if each.copy and each.copies else (len(each.received), sent)
        received = arrived / copies if copies else np.nan
        late = len(each.late) / sent if sent else np.nan
        lines.append((received, late, each.silent / each.participants if each.participants else np.nan))
    return 100.0 * np.array(lines, dtype=np.float64).reshape(len(rounds), len(ROUNDS.names))


def report_rows(blocks: Sequence[Telemetry], reported: Reported) -> Iterator[Sent]:
    """The weights of the leader's UAV and the spread of all models, in ticks for which the world asked for them."""
    if not reported.weights:
        return
    ticks = np.concatenate([block.report_ticks for block in blocks]).astype(np.int64)
    reports = np.concatenate([block.reports for block in blocks])
    yield from scalars(WEIGHTS, ticks, reports[:, reported.drawn])
    yield from scalars(SPREAD.entity, ticks, np.concatenate([block.spread for block in blocks]))
