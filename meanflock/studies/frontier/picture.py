"""The pictures of a frontier: bits against loss, a line a controller; panels by target and number of UAVs."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from meanflock.results.plots import plotstyle
from meanflock.studies.frontier.record import FrontierCell, FrontierRecord

_PANEL_IN = 3.0
_ROOM = 2.3  # factor above and below the bits: two of 1, 2, 5, 10, … lie within its square
_NEVER = 0.93  # height of the marks of a target that was never reached, of the panel
_LEADS = (1.0, 2.0, 5.0)


def draw(record: FrontierRecord, mission: str) -> Figure:
    """The picture of a mission."""
    sizes = [uavs for uavs in record.sizes() if record.cells_of(mission, uavs)]
    names = list(dict.fromkeys(cell.row for cell in record.cells_of(mission)))
    looks = plotstyle.looks(names)
    with plotstyle.style():
        figure = plotstyle.figure(
            max(plotstyle.COLUMN_IN, 2.2 + _PANEL_IN * len(sizes)), _PANEL_IN * len(record.targets)
        )
        panels = figure.subplots(len(record.targets), len(sizes), squeeze=False, sharex=True, sharey=True)
        numbered = iter(range(panels.size))
        for row, target in enumerate(record.targets):
            for column, uavs in enumerate(sizes):
                ax = panels[row, column]
                _panel(ax, record.cells_of(mission, uavs), row, looks)
                plotstyle.titled(ax, plotstyle.letter(next(numbered)), f"{uavs} UAVs, {target.name} free")
                if not column:
                    ax.set_ylabel("fewest bits (kbit)")
                if row == len(record.targets) - 1:
                    ax.set_xlabel("lost broadcasts (%)")
        _axes(panels[0, 0], record.cells_of(mission))
        never = Line2D([], [], linestyle="", marker="x", color=plotstyle.INK, label="never reached")
        plotstyle.legend(figure, names, markers=True, extra=[never], looks=looks)
    return figure


def write(record: FrontierRecord, out: Path) -> list[Path]:
    """Writes `out`/MISSION.png and .svg for each mission.

    Raises:
        BadInput: the folder cannot be made.
        RunFailed: the disk is full.
    """
    return [
        path for mission in record.missions() for path in plotstyle.save(draw(record, mission), out, Path(mission).stem)
    ]


def _panel(ax: Axes, cells: Sequence[FrontierCell], target: int, looks: Mapping[str, plotstyle.MethodLook]) -> None:
    """The lines of a target. A line has a gap, and a cross at the top, where the target was never reached."""
    for number, (name, look) in enumerate(looks.items()):
        own = sorted((cell for cell in cells if cell.row == name), key=lambda cell: cell.outage)
        loss = np.array([100.0 * cell.outage for cell in own])
        reached = [cell.reached[target] for cell in own]
        kbit = np.array([np.nan if one is None else one.kbit for one in reached])
        ax.plot(loss, kbit, color=look.colour, marker=look.marker, markeredgecolor="white", markeredgewidth=0.5)
        never = loss[np.isnan(kbit)]
        height = np.full(len(never), _NEVER - 0.07 * number)
        ax.plot(never, height, "x", color=look.colour, markersize=5, transform=ax.get_xaxis_transform())


def _axes(ax: Axes, cells: Sequence[FrontierCell]) -> None:
    """Axes that all panels share: the losses that were flown, and numbers for the bits."""
    losses = sorted({100.0 * cell.outage for cell in cells})
    ax.set_xticks(losses, [f"{loss:g}" for loss in losses])
    ax.set_xlim(min(losses) - 4.0, max(losses) + 4.0)
    kbit = [one.kbit for cell in cells for one in cell.reached if one is not None and one.kbit > 0]
    if not kbit:  # the range of what was flown
        kbit = [value for cell in cells for policy in cell.policies for value in policy.search.kbit if value > 0]
    crosses = 3.0 if any(one is None for cell in cells for one in cell.reached) else 1.0
    ax.set_yscale("log")
    ax.set_ylim(min(kbit, default=1.0) / _ROOM, max(kbit, default=10.0) * _ROOM * crosses)
    low, high = ax.get_ylim()
    leads = _LEADS if high < 100.0 * low else _LEADS[:1]
    ax.yaxis.set_major_locator(LogLocator(subs=leads, numticks=20))
    ax.yaxis.set_major_formatter(FuncFormatter(_plain))
    ax.yaxis.set_minor_formatter(NullFormatter())


def _plain(value: float, _: int | None = None) -> str:
    return f"{value:,g}"
