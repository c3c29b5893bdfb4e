"""How fast meanflock is, beside the floor of the same machine in the same minute. `python -m benchmarks --help`.

One file a race; a race measures a thing and its floor in turns, A/B/A/B, and reports medians, spreads and ratios.
A time alone says more about the machine than about the program; a ratio says what the program adds.
"""

import os

# As the Makefile has it, and before NumPy is loaded: a swarm is already as many processes as it has vehicles.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("CI", "1")  # no tool of a benchmark phones home
