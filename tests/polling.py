"""Waiting for what others do: looking again until a deadline, never sleeping for as long as it should take."""

import time
from collections.abc import Callable
from typing import Any

DEADLINE_S = 180.0  # costs nothing where it is not reached; below the timeout of a test
# So long a frozen process certainly keeps its link: a lease of 10 s, less the quarter between two signs of life.
LINK_SURE_S = 7.0


def until(
    true: Callable[[], Any],
    condition: str,
    deadline_s: float = DEADLINE_S,
    pause_s: float = 0.02,
    seen: Callable[[], object] = str,
) -> Any:
    """Calls `true()` until it is, and returns what it was. `seen()`: what there is instead, said if it never is."""
    end = time.monotonic() + deadline_s
    while True:
        if result := true():
            return result
        assert time.monotonic() < end, f"not within {deadline_s:.0f} s: {condition} {seen()}"
        time.sleep(pause_s)
