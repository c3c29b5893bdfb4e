"""The look of every method: a colour, a marker and a dash, the same in every figure of the paper's methods."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple
from zlib import crc32

Dash = tuple[float, tuple[float, ...]]


class Look(NamedTuple):
    """How a method is drawn: colour, marker of its points, dashes of its lines and their width, points."""

    colour: str
    marker: str
    dash: Dash
    width: float = 1.4


# Okabe and Ito's palette, told apart with every common colour vision; marker and dash say the same once more.
LOOKS = {
    "hjb": Look("#D55E00", "s", (0, (5, 1.6))),
    "mfg": Look("#7F7F7F", "D", (0, (1, 1.2))),
    "mfgfl-h": Look("#E69F00", "^", (0, (3, 1, 1, 1))),
    "mfgfl-f": Look("#009E73", "v", (0, (2, 1))),
    "mfgfl-hf": Look("#0072B2", "o", (0, ()), 1.9),
    "offline": Look("#CC79A7", "X", (0, (6, 1, 1, 1, 1, 1))),
}
# Of methods that have no look of their own: each by its name, unless somebody else in the figure has it.
OTHER_COLOURS = ("#56B4E9", "#332288", "#882255", "#999933", "#661100", "#44AA99")
OTHER_MARKERS = ("P", "8", "<", ">", "p", "h", "d")
OTHER_DASHES: tuple[Dash, ...] = ((0, (4, 1)), (0, (1, 0.8)), (0, (4, 1, 1, 1)), (0, (7, 2)))
NAMES = {
    "hjb": "Hjb",
    "mfg": "Mfg",
    "mfgfl-h": "MfgFL-H",
    "mfgfl-f": "MfgFL-F",
    "mfgfl-hf": "MfgFL-HF",
    "offline": "Offline",
}


def name(method: str) -> str:
    """A method as the paper writes it."""
    return NAMES.get(method, method)


def look(method: str) -> Look:
    """A method's look, whoever else is in the figure."""
    at = crc32(method.encode())
    colour, marker = OTHER_COLOURS[at % len(OTHER_COLOURS)], OTHER_MARKERS[at % len(OTHER_MARKERS)]
    return LOOKS.get(method, Look(colour, marker, OTHER_DASHES[at % len(OTHER_DASHES)]))


def colour(method: str) -> str:
    """A method's colour in every figure."""
    return look(method).colour


def looks(methods: Iterable[str]) -> dict[str, Look]:
    """The looks of the methods of one figure: no two have the same colour or marker while there are others left."""
    named = list(dict.fromkeys(methods))
    found = {method: look(method) for method in named if method in LOOKS}
    for method in named:
        if method not in found:
            own = look(method)
            tone = _free(own.colour, OTHER_COLOURS, "colour", found.values())
            shape = _free(own.marker, OTHER_MARKERS, "marker", found.values())
            found[method] = own._replace(colour=tone, marker=shape)
    return {method: found[method] for method in named}


def _free(own: str, others: Sequence[str], part: str, taken: Iterable[Look]) -> str:
    """One's own if nobody has it, else the next of the others, or of the paper's, that is free; else one's own."""
    first = others.index(own)
    papers, has = ([getattr(each, part) for each in looks] for looks in (LOOKS.values(), taken))
    return next((each for each in (*others[first:], *others[:first], *papers) if each not in has), own)
