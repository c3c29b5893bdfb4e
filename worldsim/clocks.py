"""Clocks of a flight: its schedule in real time, its wall-clock time, and histograms of durations."""

import math
import time
from array import array
from bisect import bisect_left
from collections.abc import Callable
from itertools import accumulate

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


class TickSchedule:
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


class Stopwatch:
    """Wall-clock time of a flight, in s, since take-off; the time flown before it was resumed counts, too."""

    def __init__(self, before_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        """`before_s`: time flown before. `clock`: seconds, monotonic."""
        self._before_s = before_s
        self._clock = clock
        self._begun = clock()

    def restart(self) -> None:
        """Take off now."""
        self._begun = self._clock()

    @property
    def seconds(self) -> float:
        """The time flown so far."""
        return self._before_s + self.flown_s

    @property
    def flown_s(self) -> float:
        """The time flown since take-off, or since the run was resumed."""
        return self._clock() - self._begun


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
        bounds = [*(f"{bound:g}" for bound in BOUNDS_S), "+Inf"]
        return list(zip(bounds, accumulate(list(self._counts)), strict=True))
