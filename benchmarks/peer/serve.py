"""A peer's side of a race: for every number read, do the work that often and print the milliseconds of one time."""

import sys
import time
from collections.abc import Callable


def serve(work: Callable[[], object]) -> None:
    """Says "ready", then answers until standard input ends."""
    answer, sys.stdout = sys.stdout, sys.stderr  # what the library prints is no answer
    work()
    print("ready", file=answer, flush=True)
    for line in sys.stdin:
        count = int(line)
        start = time.perf_counter()
        for _ in range(count):
            work()
        print((time.perf_counter() - start) / count * 1e3, file=answer, flush=True)
