"""Functions of arrays and bytes that exist compiled and in NumPy, and the choice between the two forms, made once.

With MEANFLOCK_PURE=1, NumPy runs. Otherwise the extension `kernels._native` runs, if it was built from the sources in
this folder; else NumPy. Both give the same bits, and other code does not depend on the choice. `kernels/reference.py`
imports the files that define the functions.
"""

import os

try:
    if os.environ.get("MEANFLOCK_PURE") == "1":
        raise ImportError("MEANFLOCK_PURE=1 selects NumPy")
    from meanflock.kernels.compiled import *  # noqa: F403  # its `__all__` names the functions
except ImportError:
    from meanflock.kernels.reference import *  # noqa: F403
