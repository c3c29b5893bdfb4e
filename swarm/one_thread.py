"""Limit BLAS to one thread, because all matrices are small and many agents share the cores. No result depends on it.

Only the entry points of processes import this module, before NumPy. A user of the Python API decides for themselves.
"""

import os

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
