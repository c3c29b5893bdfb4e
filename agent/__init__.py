"""A UAV's mind: two small networks that learn online, and the node that runs them as rows of one process."""

import swarm  # noqa: F401  # before NumPy: it holds BLAS to one thread
