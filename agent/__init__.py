"""A UAV's mind: two small networks that learn online, and the node that runs them as rows of one process."""

from meanflock import swarm  # noqa: F401  # before NumPy: it holds BLAS to one thread
