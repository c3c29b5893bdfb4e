"""Wall-clock time: the schedule of a flight in real time, and histograms of durations."""

import math
from array import array
from bisect import bisect_left

import numpy as np

from meanflock.swarm.errors import BadInput

BOUNDS_S = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)


def factor(text: str) -> float:
    """Parse the option --realtime: how many times faster than the wall clock the flight goes.

    Raises:
        BadInput: not a number above 0.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise BadInput(
            f"--realtime {text}: how many times faster than the wall clock, above 0; for example --realtime=2"
        )
    return value


class Schedule:
    """Begin and end of each tick of a flight that follows the wall clock, on the monotonic clock."""

    def __init__(self, factor: float, dt: float) -> None:
        """`factor`: simulated seconds a second. `dt`: simulated seconds a tick."""
        self.factor = factor
        self._tick_s = dt / factor
        self._late_s = array("f")  # one number a tick: a day in real time is 3.5 MB

    def begin(self, now: float) -> None:
        """Begin the next tick. The first tick defines the schedule, so it is in time."""
        if not self._late_s:
            self._start = now
        self._late_s.append(now - self._start - len(self._late_s) * self._tick_s)

    @property
    def end(self) -> float:
        """Time at which the current tick ends and the next one should begin."""
        return self._start + len(self._late_s) * self._tick_s

    def jitter_ms(self) -> dict[str, float | None]:
        """Delay of the begin of a tick behind its schedule: mean, 99th percentile and maximum."""
        if not self._late_s:
            return {"mean": None, "p99": None, "max": None}
        late = np.frombuffer(self._late_s, dtype=np.float32) * 1e3
        return {
            "mean": float(late.mean(dtype=np.float64)),
            "p99": float(np.percentile(late, 99)),
            "max": float(late.max()),
        }


class Durations:
    """Histogram of durations. `add` is cheap enough for every tick; other threads may read at any time."""

    def __init__(self) -> None:
        self._counts = [0] * (len(BOUNDS_S) + 1)  # the last one: beyond all bounds
        self.total_s = 0.0

    def add(self, seconds: float) -> None:
        """Count one duration."""
        self._counts[bisect_left(BOUNDS_S, seconds)] += 1
        self.total_s += seconds

    @property
    def cumulative(self) -> list[tuple[str, int]]:
        """Pairs of an upper bound in seconds and the number of durations up to it; the last bound is +Inf."""
        total = 0
        rows = []
        for bound, count in zip((*BOUNDS_S, float("inf")), list(self._counts), strict=True):
            total += count
            rows.append((f"{bound:g}" if bound < float("inf") else "+Inf", total))
        return rows
