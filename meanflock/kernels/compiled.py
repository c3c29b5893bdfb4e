"""Compiled form of the functions of `kernels.reference`, with the same bits; one call replaces some eighty of NumPy's.

With many processes on a core, calls are expensive, because code and data of each are no longer in the caches.
"""

from typing import Any

from meanflock.kernels._native import (
    SOURCES,
    alignment,
    closest,
    columns,
    fade,
    fly,
    interpolate,
    largest,
    learn,
    move,
    multiply,
    nearest,
    neighbours,
    pairs,
    pick,
    poisson,
    reached,
    read,
    repel,
    send,
    solve,
    tables,
    waves,
    write,
)
from meanflock.kernels.mean_field.layout import Tables, packed
from meanflock.kernels.sources import checksum

if checksum() not in (0, SOURCES):
    raise ImportError("kernels._native was built from other sources than those in this folder")

__all__ = [
    "BACKEND",
    "alignment",
    "closest",
    "columns",
    "fade",
    "fly",
    "interpolate",
    "largest",
    "learn",
    "move",
    "multiply",
    "nearest",
    "neighbours",
    "pairs",
    "pick",
    "poisson",
    "prepare",
    "reached",
    "read",
    "repel",
    "send",
    "solve",
    "waves",
    "write",
]

BACKEND = "compiled"


def prepare(given: Tables) -> Any:
    """See `kernels.reference.prepare`."""
    return tables(*packed(given))
