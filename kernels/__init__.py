"""Functions of arrays and bytes that are worth compiling, and the choice between their two forms, made once.

MEANFLOCK_PURE=1 takes NumPy, else the extension `kernels._native` is taken, unless it is missing or was built from
other sources than those beside it, else NumPy. Both give the same bits, and nobody else knows which one runs. What
they compute is written in `kernels/reference.py`, `kernels/halfplanes.py` and `kernels/wire.py`.
"""

import os

from meanflock.kernels.tables import Tables

__all__ = [
    "BACKEND",
    "Tables",
    "alignment",
    "columns",
    "learn",
    "nearest",
    "pairs",
    "prepare",
    "read",
    "repel",
    "write",
]

if os.environ.get("MEANFLOCK_PURE") == "1":
    from meanflock.kernels.reference import (
        BACKEND,
        alignment,
        columns,
        learn,
        nearest,
        pairs,
        prepare,
        read,
        repel,
        write,
    )
else:
    try:
        from meanflock.kernels.compiled import (
            BACKEND,
            alignment,
            columns,
            learn,
            nearest,
            pairs,
            prepare,
            read,
            repel,
            write,
        )
    except ImportError:
        from meanflock.kernels.reference import (
            BACKEND,
            alignment,
            columns,
            learn,
            nearest,
            pairs,
            prepare,
            read,
            repel,
            write,
        )
