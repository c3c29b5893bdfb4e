"""The same functions as `kernels.reference`, to the same bits: one call takes the place of some eighty of NumPy's.

Among many processes that take turns on a core it is calls that cost: each finds its code and data gone from the caches.
"""

from typing import Any

from meanflock.kernels._native import SOURCES, alignment, columns, learn, nearest, pairs, read, repel, tables, write
from meanflock.kernels.mean_field.layout import Tables, packed
from meanflock.kernels.sources import checksum

if checksum() not in (0, SOURCES):
    raise ImportError("kernels._native was built from other sources than those that lie beside it")

__all__ = ["BACKEND", "alignment", "columns", "learn", "nearest", "pairs", "prepare", "read", "repel", "write"]

BACKEND = "compiled"


def prepare(given: Tables) -> Any:
    """See `kernels.reference.prepare`."""
    return tables(*packed(given))
