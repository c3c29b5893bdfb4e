"""The style of every figure: a colour, marker and dash a method, units on every axis, equal bytes for equal data."""

import io
import re
import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from string import ascii_lowercase
from typing import Any, Literal, NamedTuple
from zlib import crc32

import matplotlib as mpl
import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from meanflock.results.quantities import axis_label
from meanflock.results.statistics import Estimate
from meanflock.swarm import durable
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Obstacle

Floats = NDArray[np.float64]
Dash = tuple[float, tuple[float, ...]]


class MethodLook(NamedTuple):
    """Style of a method: colour, marker, dashes and width of its lines, in points."""

    colour: str
    marker: str
    dash: Dash
    width: float = 1.4


# Okabe and Ito's palette, for every common colour vision; marker and dash carry the same information.
LOOKS = {
    "hjb": MethodLook("#D55E00", "s", (0, (5, 1.6))),
    "mfg": MethodLook("#7F7F7F", "D", (0, (1, 1.2))),
    "mfgfl-h": MethodLook("#E69F00", "^", (0, (3, 1, 1, 1))),
    "mfgfl-f": MethodLook("#009E73", "v", (0, (2, 1))),
    "mfgfl-hf": MethodLook("#0072B2", "o", (0, ()), 1.9),
    "offline": MethodLook("#CC79A7", "X", (0, (6, 1, 1, 1, 1, 1))),
}
# For methods without a look of their own: chosen by the name, unless another method of the figure has it.
OTHER_COLOURS = ("#56B4E9", "#332288", "#882255", "#999933", "#661100", "#44AA99")
OTHER_MARKERS = ("P", "8", "<", ">", "p", "h", "d")
SOLID: Dash = (0, ())
OTHER_DASHES: tuple[Dash, ...] = ((0, (4, 1)), (0, (1, 0.8)), (0, (4, 1, 1, 1)), (0, (7, 2)))
COLOURS = (*OTHER_COLOURS, *(each.colour for each in LOOKS.values()))
MARKERS = (*(each.marker for each in LOOKS.values()), *OTHER_MARKERS)
DASHES = (SOLID, *OTHER_DASHES, *(each.dash for each in LOOKS.values() if each.dash != SOLID))
MOST_LOOKS = len(COLOURS) * len(DASHES)  # that differ; there are more markers than dashes
GROUPS = ("#0072B2", "#E69F00", "#882255", "#44AA99", "#999933", "#56B4E9")  # of the groups of a flight, in order
NAMES = {
    "hjb": "Hjb",
    "mfg": "Mfg",
    "mfgfl-h": "MfgFL-H",
    "mfgfl-f": "MfgFL-F",
    "mfgfl-hf": "MfgFL-HF",
    "offline": "Offline",
}

WIDTHS_IN = {1: 3.5, 2: 7.16}  # of figures in one and in two printed columns
COLUMN_IN = 4.6  # drawn a little larger than a printed column (3.5 in); text is 8 to 9 points here, 6 to 7 in print
PAGE_IN = 7.6
DPI = 200

INK = "#222222"
STAR: dict[str, Any] = {  # a collision, wherever paths are drawn
    "linestyle": "",
    "marker": "*",
    "markersize": 6.5,
    "color": "#CC2222",
    "markeredgecolor": "white",
    "markeredgewidth": 0.4,
}
CROSS: dict[str, Any] = {**STAR, "marker": "X", "markersize": 5.0, "color": INK}  # an obstacle hit
FALLEN: dict[str, Any] = {**STAR, "marker": "v", "markersize": 5.0, "color": "#8B5CF6"}  # a UAV that hit the ground
PALE = "#9A9A9A"
GOAL = "#2E8B57"
TRIANGLE: dict[str, Any] = {**STAR, "marker": "^", "markersize": 6.0, "color": INK}  # a station
RING: dict[str, Any] = {  # the goal, in a legend
    "linestyle": "",
    "marker": "o",
    "markersize": 6,
    "color": GOAL,
    "markerfacecolor": "none",
    "markeredgewidth": 1.6,
}
SQUARE: dict[str, Any] = {**RING, "marker": "s", "color": INK, "markeredgewidth": 1.2}  # a landing place
OBSTACLE: dict[str, Any] = {  # obstacles, in a legend
    "linestyle": "",
    "markersize": 6,
    "color": PALE,
    "markeredgecolor": INK,
    "markeredgewidth": 0.5,
}
PHI_G: dict[str, Any] = {"norm": LogNorm(1e-3, 1e0, clip=True), "cmap": "viridis"}  # its colours
LETTERS_IN = 14.0  # letters of a title that an inch has room for
_TEX = {  # longer names first
    "φ_A(T_avg)": r"\phi_A(T_\mathrm{avg})",
    "φ_C(T_avg)": r"\phi_C(T_\mathrm{avg})",
    "T_avg": r"T_\mathrm{avg}",
    "φ_A": r"\phi_A",
    "φ_C": r"\phi_C",
    "φ_G": r"\phi_G",
    "|e_H|": "|e_H|",
    "|e_F|": "|e_F|",
    "e_H": "e_H",
    "e_F": "e_F",
}
_SYMBOL = re.compile("|".join(map(re.escape, _TEX)))

VARIED = {  # labels of the coordinates of a study
    "uavs": "number of UAVs $N$",
    "period": "ticks a round $n_0$",
    "sigma": r"wind $\sigma$ (m s$^{-1}$ s$^{-1/2}$)",
}

_RC: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 8.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.linewidth": 0.7,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "xtick.major.size": 2.8,
    "ytick.major.size": 2.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.5,
    "lines.markersize": 4.2,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "figure.constrained_layout.h_pad": 0.05,
    "figure.constrained_layout.w_pad": 0.05,
    "savefig.dpi": DPI,
    "svg.hashsalt": "meanflock",
    "svg.fonttype": "path",  # looks the same on a machine without the font
    "pdf.fonttype": 42,  # embeds fonts as TrueType, which publishers ask for
}

_CAPTION_LETTERS_IN = 17.0  # letters of a caption that an inch has room for
_LEGEND_LETTERS_IN = 14.7  # in an inch of a legend
_HANDLE_LETTERS = 8  # that a line or a mark and the space beside it take
_LEGEND_COLUMNS = 5  # at most
_LEGEND_ROW_IN, _LEGEND_LINE_IN = 0.17, 0.133  # height of a row of a legend, and of each more line of a name
_METADATA: dict[str, dict[str, None]] = {  # of each format, without dates and programs
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
FORMATS = tuple(_METADATA)
_LAID_OUT: Any = {"figure.constrained_layout.use": False, "figure.autolayout": False}


def name(method: str) -> str:
    """A method as the paper writes it."""
    return NAMES.get(method, method)


def look(method: str) -> MethodLook:
    """A method's preferred look."""
    at = crc32(method.encode())
    colour, marker = OTHER_COLOURS[at % len(OTHER_COLOURS)], OTHER_MARKERS[at % len(OTHER_MARKERS)]
    return LOOKS.get(method, MethodLook(colour, marker, OTHER_DASHES[at % len(OTHER_DASHES)]))


def colour(method: str) -> str:
    """A method's colour in every figure."""
    return look(method).colour


def group_colour(number: int) -> str:
    """The colour of a group by its number; the colours begin again after the last."""
    return GROUPS[number % len(GROUPS)]


def group_dash(number: int) -> Dash:
    """The dash of a group by its number: solid, and another one whenever the colours begin again."""
    return (SOLID, *OTHER_DASHES)[number // len(GROUPS) % (1 + len(OTHER_DASHES))]


def looks(methods: Iterable[str]) -> dict[str, MethodLook]:
    """Looks of the methods of one figure; two share a colour or marker only if no other is free.

    Up to `MOST_LOOKS` of them, those of one colour differ in marker and in dash.
    """
    named = list(dict.fromkeys(methods))
    found = {method: look(method) for method in named if method in LOOKS}
    for method in named:
        if method not in found:
            found[method] = _unlike(look(method), list(found.values()))
    return {method: found[method] for method in named}


def variant(own: MethodLook, number: int) -> MethodLook:
    """A look in the same colour, with the marker and the dash of a number below that of `DASHES`."""
    return own._replace(marker=MARKERS[number], dash=DASHES[number])


def _unlike(own: MethodLook, taken: Sequence[MethodLook]) -> MethodLook:
    """The preferred look with the rarest colour, and a marker and a dash that no other look of this colour has."""
    used = Counter(each.colour for each in taken)
    tone = min(_beginning(own.colour, OTHER_COLOURS, COLOURS), key=lambda each: used[each])
    alike = [each for each in taken if each.colour == tone]
    shapes, dashes = ({getattr(each, part) for each in alike} for part in ("marker", "dash"))
    used = Counter(each.marker for each in taken)
    shape = min(_beginning(own.marker, OTHER_MARKERS, MARKERS), key=lambda each: (each in shapes, used[each]))
    dash = min((own.dash, *DASHES), key=lambda each: each in dashes)
    return own._replace(colour=tone, marker=shape, dash=dash)


def _beginning(own: str, others: Sequence[str], every: Sequence[str]) -> list[str]:
    """All values, the preferred one first, then the others after it, around their end, and last the paper's."""
    first = others.index(own)
    return list(dict.fromkeys((*others[first:], *others[:first], *every)))


@contextmanager
def style() -> Iterator[None]:
    """Context with our plot settings, which override the user's `matplotlibrc`."""
    with mpl.style.context(["default", _RC]):
        yield


class _NotebookFigure(Figure):
    """A figure that a notebook shows as a picture, whatever its backend is."""

    def _repr_png_(self) -> bytes:
        drawn = io.BytesIO()
        with style():
            self.savefig(drawn, format="png")
        return drawn.getvalue()


def figure(width_in: float, height_in: float) -> Figure:
    """An empty figure on the Agg canvas; no global state, no window."""
    result = _NotebookFigure(figsize=(width_in, height_in))
    FigureCanvasAgg(result)
    return result


def save(drawing: Figure, folder: Path, name: str, formats: Sequence[str] = ("png", "svg")) -> list[Path]:
    """Writes `name` in each of some FORMATS, each file whole or not at all; equal figures give equal bytes.

    The layout is computed for the first format, and reused for the others.

    Raises:
        BadInput: the folder cannot be made.
        RunFailed: the disk is full.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{folder}: {error.strerror}; name a folder that can be written: --out DIR") from error
    paths = []
    layout = drawing.get_layout_engine()
    for form in formats:
        drawn = io.BytesIO()
        with style():
            drawing.savefig(drawn, format=form, metadata=_METADATA[form])
        paths.append(durable.put(folder / f"{name}.{form}", drawn.getbuffer()))
        with mpl.rc_context(_LAID_OUT):
            drawing.set_layout_engine()
    drawing.set_layout_engine(layout)
    return paths


def write(figures: Mapping[str, Figure], out: Path, formats: Sequence[str] = ("png", "svg")) -> list[Path]:
    """Writes every figure as `out`/name in each format.

    Raises:
        BadInput: the folder cannot be made.
        RunFailed: the disk is full.
    """
    return [path for name, drawing in figures.items() for path in save(drawing, out, name, formats)]


def axis(field: str) -> str:
    """The label of an axis: symbol and unit of a field, or a coordinate of a study."""
    return VARIED.get(field) or tex(axis_label(field))


def obstacle_marker(obstacles: Iterable[Obstacle]) -> str:
    """The marker of obstacles in a legend: a square if all are polygons, else a disc."""
    return "s" if all(obstacle.polygon for obstacle in obstacles) else "o"


def letter(number: int) -> str:
    """Letter of a panel, counted from 0: a, b, … z, aa, ab, …"""
    first, second = divmod(number, len(ascii_lowercase))
    return (ascii_lowercase[first - 1] if first else "") + ascii_lowercase[second]


def titled(ax: Axes, letter: str, text: str, left_in: float = 0.0) -> None:
    """Set a panel's letter and title, flush left, broken into lines that fit.

    `left_in`: width of what stands left of all panels.
    """
    place, drawing = ax.get_subplotspec(), ax.get_figure(root=True)
    assert drawing is not None
    columns = place.get_gridspec().ncols if place is not None else 1
    room = int(LETTERS_IN * (drawing.get_figwidth() - left_in) / columns)
    lines = (textwrap.fill(line, room) for line in (f"({letter}) {text}" if letter else text).splitlines())
    ax.set_title(tex("\n".join(lines)), loc="left", pad=4)


def captioned(drawing: Figure, text: str) -> None:
    """Set the caption below all panels, each of its lines broken into lines that fit."""
    room = int(_CAPTION_LETTERS_IN * drawing.get_figwidth())
    lines = (textwrap.fill(line, room) for line in text.splitlines())
    drawing.supxlabel(tex("\n".join(lines)), fontsize=7, color=INK)


def tex(text: str) -> str:
    """A name with its symbols set as mathematics."""
    return _SYMBOL.sub(lambda found: f"${_TEX[found.group()]}$", text)


def legend(
    drawing: Figure,
    methods: Sequence[str],
    markers: bool = False,
    extra: Sequence[Line2D] = (),
    looks: Mapping[str, MethodLook] | None = None,
) -> None:
    """One legend above all panels; with `looks` those and the names as they are typed, else those of the paper.

    Long names are broken into lines. Each row after the first, and each line, makes the figure higher.
    """
    handles = []
    for method in methods:
        seen = look(method) if looks is None else looks[method]
        handle = Line2D([], [], color=seen.colour, label=name(method) if looks is None else method)
        handle.set_linestyle("-" if markers else seen.dash)
        handle.set_marker(seen.marker if markers else "")
        handles.append(handle)
    place_legend(drawing, [*handles, *extra])


def place_legend(
    drawing: Figure,
    handles: Sequence[Line2D],
    where: Literal["outside upper center", "outside lower center"] = "outside upper center",
) -> None:
    """Put a legend of these lines and marks above or below all panels; likewise."""
    long = 2.6 if any(handle.get_linestyle() != "None" for handle in handles) else 1.0
    room = int(_LEGEND_LETTERS_IN * drawing.get_figwidth())
    names = [textwrap.fill(str(handle.get_label()), room - _HANDLE_LETTERS) for handle in handles]
    widths = [_HANDLE_LETTERS + max(map(len, each.splitlines())) for each in names]
    columns = len(handles) if sum(widths) <= room else max(1, room // max(widths))
    columns = min(columns, len(handles), _LEGEND_COLUMNS)
    rows, broken = -(-len(handles) // columns), sum(each.count("\n") for each in names)
    drawing.set_figheight(drawing.get_figheight() + _LEGEND_ROW_IN * (rows - 1) + _LEGEND_LINE_IN * broken)
    drawing.legend(
        handles=handles,
        labels=names,
        loc=where,
        ncols=columns,
        handlelength=long,
        columnspacing=1.4,
    )


def mark(seen: MethodLook, label: str, **changed: Any) -> Line2D:
    """A method's mark in a legend, with a line unless `linestyle` says otherwise."""
    return Line2D([], [], color=seen.colour, marker=seen.marker, label=label, **changed)


def curve(ax: Axes, method: str, x: Floats, y: Floats, low: Floats | None = None, high: Floats | None = None) -> None:
    """A method's line over x, and a band where one is given."""
    if low is not None and high is not None:
        ax.fill_between(x, low, high, color=colour(method), alpha=0.16, linewidth=0)
    seen = look(method)
    ax.plot(x, y, color=seen.colour, linestyle=seen.dash, linewidth=seen.width)


def paths(ax: Axes, position: Floats, colour: str | Floats, width: float = 0.7, dash: Dash = SOLID) -> None:
    """Paths `(T, N, 2)` in one colour and dash, or coloured by φ_G `(T, N)`."""
    lines = position.swapaxes(0, 1)
    look: dict[str, Any] = {"colors": colour, "linestyles": [dash]}
    if not isinstance(colour, str):
        lines = np.stack([position[:-1], position[1:]], axis=-2).reshape(-1, 2, 2)
        look = {"array": colour[1:].ravel(), **PHI_G}
    ax.add_collection(LineCollection(list(lines), linewidths=width, rasterized=True, **look))


def dots(ax: Axes, seen: MethodLook, x: Floats, estimates: Sequence[Estimate], joined: bool = True) -> None:
    """A method's points with their intervals, joined by a line; an end that is not finite is not drawn."""
    y, low, high = (np.array([getattr(each, end) for each in estimates]) for end in ("value", "low", "high"))
    bars = np.nan_to_num(np.stack([y - low, high - y]), nan=0.0, posinf=0.0, neginf=0.0)
    ax.errorbar(
        x,
        y,
        yerr=np.maximum(bars, 0.0),
        color=seen.colour,
        marker=seen.marker,
        markeredgecolor="white",
        markeredgewidth=0.5,
        linestyle="-" if joined else "",
        linewidth=1.3,
        elinewidth=1.0,
        capsize=2.0,
        capthick=0.9,
    )


def log_axis(ax: Axes) -> None:
    """A logarithmic y axis; where it spans less than two decades, more of its numbers are written out."""
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    leads = (1.0,) if high >= 100 * low else (1.0, 3.0) if high >= 10 * low else (1.0, 2.0, 3.0, 5.0, 7.0)
    ax.yaxis.set_major_locator(LogLocator(subs=leads, numticks=8))
    if len(leads) > 1:
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())


def bit_axis(axis: Axis) -> None:
    """Ticks of bits as 500 k, 2 M."""
    axis.set_major_formatter(EngFormatter())
