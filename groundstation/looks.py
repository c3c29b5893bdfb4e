"""The look of every method: a colour, a marker and a dash, the same in every figure of the paper's methods."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple
from zlib import crc32

Dash = tuple[float, tuple[float, ...]]

# Okabe and Ito's palette, told apart with every common colour vision; marker and dash say the same once more.
COLOURS = {
    "hjb": "#D55E00",
    "mfg": "#7F7F7F",
    "mfgfl-h": "#E69F00",
    "mfgfl-f": "#009E73",
    "mfgfl-hf": "#0072B2",
    "offline": "#CC79A7",
}
MARKERS = {"hjb": "s", "mfg": "D", "mfgfl-h": "^", "mfgfl-f": "v", "mfgfl-hf": "o", "offline": "X"}
DASHES: dict[str, tuple[float, tuple[float, ...]]] = {
    "hjb": (0, (5, 1.6)),
    "mfg": (0, (1, 1.2)),
    "mfgfl-h": (0, (3, 1, 1, 1)),
    "mfgfl-f": (0, (2, 1)),
    "mfgfl-hf": (0, ()),
    "offline": (0, (6, 1, 1, 1, 1, 1)),
}
WIDTHS = {"mfgfl-hf": 1.9}  # of the lines that stand out, points
# Of methods that have no look of their own: each by its name, unless somebody else in the figure has it.
OTHER_COLOURS = ("#56B4E9", "#332288", "#882255", "#999933", "#661100", "#44AA99")
OTHER_MARKERS = ("P", "8", "<", ">", "p", "h", "d")
OTHER_DASHES: tuple[tuple[float, tuple[float, ...]], ...] = ((0, (4, 1)), (0, (1, 0.8)), (0, (4, 1, 1, 1)), (0, (7, 2)))
NAMES = {
    "hjb": "Hjb",
    "mfg": "Mfg",
    "mfgfl-h": "MfgFL-H",
    "mfgfl-f": "MfgFL-F",
    "mfgfl-hf": "MfgFL-HF",
    "offline": "Offline",
}


class Look(NamedTuple):
    """How a method is drawn: colour, marker of its points, dashes of its lines and their width, points."""

    colour: str
    marker: str
    dash: Dash
    width: float


def colour(method: str) -> str:
    """A method's colour in every figure."""
    return COLOURS.get(method) or OTHER_COLOURS[crc32(method.encode()) % len(OTHER_COLOURS)]


def marker(method: str) -> str:
    """The marker of its points."""
    return MARKERS.get(method) or OTHER_MARKERS[crc32(method.encode()) % len(OTHER_MARKERS)]


def dash(method: str) -> tuple[float, tuple[float, ...]]:
    """The dashes of its lines."""
    return DASHES.get(method) or OTHER_DASHES[crc32(method.encode()) % len(OTHER_DASHES)]


def name(method: str) -> str:
    """A method as the paper writes it."""
    return NAMES.get(method, method)


def look(method: str) -> Look:
    """A method's look, whoever else is in the figure."""
    return Look(colour(method), marker(method), dash(method), WIDTHS.get(method, 1.4))


def looks(methods: Iterable[str]) -> dict[str, Look]:
    """The looks of the methods of one figure: no two have the same colour or marker while there are others left."""
    named = list(dict.fromkeys(methods))
    found = {method: look(method) for method in named if method in COLOURS}
    for method in named:
        if method not in found:
            own = look(method)
            taken = found.values()
            tone = _free(own.colour, OTHER_COLOURS, COLOURS, [each.colour for each in taken])
            shape = _free(own.marker, OTHER_MARKERS, MARKERS, [each.marker for each in taken])
            found[method] = own._replace(colour=tone, marker=shape)
    return {method: found[method] for method in named}


def _free(own: str, others: Sequence[str], papers: Mapping[str, str], taken: Sequence[str]) -> str:
    """One's own if nobody has it, else the next of the others, or of the paper's, that is free; else one's own."""
    first = others.index(own)
    return next((each for each in (*others[first:], *others[:first], *papers.values()) if each not in taken), own)
