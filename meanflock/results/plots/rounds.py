"""Learning curves of one run: diagnostics and metrics at the end of each round, over rounds, time, bits or airtime."""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from meanflock.results.flown import flown_keys
from meanflock.results.plots import plotstyle
from meanflock.results.quantities import axis_label, quantity
from meanflock.results.rounds_table import MEAN, METRIC, NO_ROUNDS, OF_UAVS, OVER, rounds_table, stored_rounds
from meanflock.results.run_folder import EVENTS
from meanflock.swarm.errors import BadInput

LABELS = {"rounds": "round", "seconds": "time (s)", "bits": "payload (bits)", "airtime": "airtime (s)"}
_PANEL_IN = 2.1  # height


def plot_rounds(folder: Path, over: str) -> dict[str, Figure]:
    """`learning`: a panel for each metric and diagnostic of the rounds in `folder`, over a key of `OVER`.

    Those that stay the same in all rounds are left out, if others change.

    Raises:
        BadInput: no run there, a damaged file, or a run without rounds or without diagnostics.
    """
    table = rounds_table(stored_rounds(folder / EVENTS), flown_keys(folder).dt)
    names = [name for prefix in (METRIC, MEAN) for name in table.column_names if name.startswith(prefix)]
    if not table.num_rows:
        raise BadInput(f"{folder}: the run has {NO_ROUNDS}")
    if not names:
        raise BadInput(
            f"{folder}: the run has rounds, but no diagnostics or metrics; fly one that has, as mfgfl-hf does"
        )
    x = table[OVER[over]].to_numpy()
    averaged = np.array(table["outcome"].to_pylist()) == "averaged"
    names = [name for name in names if len(table[name].drop_null().unique()) > 1] or names
    columns = min(2, len(names))
    rows = math.ceil(len(names) / columns)
    with plotstyle.style():
        drawing = plotstyle.figure(plotstyle.COLUMN_IN * columns, _PANEL_IN * rows + 0.3)
        axes = drawing.subplots(rows, columns, squeeze=False).ravel()
        for number, (ax, name) in enumerate(zip(axes, names, strict=False)):
            y = table[name].to_numpy(zero_copy_only=False)
            ax.plot(x, y, color=plotstyle.INK)
            ax.plot(x[averaged], y[averaged], "o", color=plotstyle.INK, markersize=3.0)
            ax.plot(x[~averaged], y[~averaged], "o", color=plotstyle.INK, markersize=3.0, markerfacecolor="white")
            plotstyle.titled(ax, plotstyle.letter(number), title(name))
            label_axes(ax, name, over)
            ax.set_xlabel(LABELS[over])
        for ax in axes[len(names) :]:
            ax.set_visible(False)
        hollow = "filled: rounds that were averaged; hollow: void rounds, and rounds that wait for more models"
        caption = [of_uavs(names), "" if averaged.all() else hollow]
        plotstyle.captioned(drawing, "\n".join(filter(None, caption)))
    return {f"learning-over-{over}": drawing}


def title(column: str) -> str:
    """The title of a panel: the name of a metric or of a share of the UAVs, or the mean of another diagnostic.

    A mean of residuals has a sign, so their names are without the bars of a size.
    """
    measured = quantity(column.removeprefix(METRIC).removeprefix(MEAN))
    name = measured.name.replace("|", "")
    return f"mean {name}" if column.startswith(MEAN) and not measured.share else name


def of_uavs(columns: Iterable[str]) -> str:
    """Says of which UAVs the means of a flight are; empty if none of the columns is a mean."""
    return OF_UAVS if any(name.startswith(MEAN) for name in columns) else ""


def label_axes(ax: Axes, column: str, over: str) -> None:
    """Label the y axis of a panel with its unit, and set the ticks of the x axis, which is over a key of `OVER`."""
    ax.set_ylabel(plotstyle.tex(axis_label(column.removeprefix(METRIC).removeprefix(MEAN)).replace("|", "")))
    if over == "rounds":
        ax.xaxis.set_major_locator(MaxNLocator(6, integer=True, min_n_ticks=1))
    elif over == "bits":
        plotstyle.bit_axis(ax.xaxis)
