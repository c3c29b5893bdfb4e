"""Benchmarks of meanflock, each in turns with a floor on the same machine. `python -m benchmarks --help`.

One file a race; a race measures a thing and its floor in turns, A/B/A/B, and reports medians, spreads and ratios.
A time depends on the machine; a ratio to the floor shows the cost of the program.
"""

import os

# As the Makefile has it, and before NumPy is loaded: a swarm is already as many processes as it has vehicles.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("CI", "1")  # no tool of a benchmark phones home
