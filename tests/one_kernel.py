"""OpenBLAS computes with the kernels of AVX2 in all tests: its own choice differs between processors in the last bits.

Imported before NumPy. Processes that a test starts inherit the variable.
"""

import os

os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")
