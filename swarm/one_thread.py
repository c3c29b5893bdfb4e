"""BLAS is held to one thread: every matrix here is small, and twenty-five agents share the cores.

Imported by what starts a process of ours, before NumPy, and by nothing else: whoever flies from Python decides this
themselves. No result depends on it.
"""

import os

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
