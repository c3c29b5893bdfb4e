"""Where a person stands: the command line, the launcher, the record of a run, and the paper's experiments."""

from meanflock import swarm  # noqa: F401  # before NumPy: it holds BLAS to one thread
