"""Limit BLAS and OpenMP to one thread, because all matrices are small and many agents share the cores.

Only the entry points of processes import this module, before NumPy. `threads.py` does the same for flights in the
process of a user of the Python API.
"""

import os

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"
