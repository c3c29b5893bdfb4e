"""Functions of arrays and bytes that are worth compiling, and the choice between their two forms, made once.

MEANFLOCK_PURE=1 takes NumPy, else the extension `kernels._native` is taken, unless it is missing or was built from
other sources than those beside it, else NumPy. Both give the same bits, and nobody else knows which one runs.
`kernels/reference.py` names the files that define what they compute.
"""

import os

__all__ = ["BACKEND", "alignment", "columns", "learn", "nearest", "pairs", "prepare", "read", "repel", "write"]

try:
    if os.environ.get("MEANFLOCK_PURE") == "1":
        raise ImportError("MEANFLOCK_PURE=1 takes NumPy")
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
