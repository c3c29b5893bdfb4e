"""What every process of the swarm agreed on beforehand: state layout, scenario, messages, bus. No physics, no learning.

BLAS is held to one thread: every matrix here is small, twenty-five agents share the cores, and a sum must not
change its bits with the number of cores. The setting only takes hold if this package is imported before NumPy.
"""

import os

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

__version__ = "0.1.0"
