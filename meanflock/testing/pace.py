"""Limit of the time of a call, for all suites."""

import time
from collections.abc import Callable

import numpy as np

from meanflock.testing.error import fail

SLOW_MS = 50.0  # half of a tick of the paper; built-in plug-ins take less than one hundredth of it
CALLS = 11


def check_pace(plugin: type, label: str, slow_ms: float, call: Callable[[int], object]) -> None:
    """Check that the median time of `call(number)`, number 1, 2, …, is at most `slow_ms`."""
    took = []
    for number in range(1, CALLS + 1):
        began = time.perf_counter()
        call(number)
        took.append(1e3 * (time.perf_counter() - began))
    if (median := float(np.median(took))) > slow_ms:
        fail(plugin, f"{label} takes {median:.0f} ms", f"make it quicker, or pass a larger `slow_ms` than {slow_ms:g}")
