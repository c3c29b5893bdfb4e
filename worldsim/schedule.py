"""Real time: when a tick should begin and end on the monotonic clock, and how well a flight keeps to it."""

import math
from array import array

import numpy as np

from meanflock.swarm.errors import BadInput


def factor(text: str) -> float:
    """How many times faster than the wall clock, as somebody typed it.

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
    """The ticks of a flight that follows the wall clock."""

    def __init__(self, factor: float, dt: float) -> None:
        """`factor`: simulated seconds a second. `dt`: simulated seconds a tick."""
        self.factor = factor
        self._tick_s = dt / factor
        self._late_s = array("f")  # one a tick: a day in real time is 3.5 MB

    def begin(self, now: float) -> None:
        """The next tick begins; the first is in time by definition."""
        if not self._late_s:
            self._start = now
        self._late_s.append(now - self._start - len(self._late_s) * self._tick_s)

    @property
    def end(self) -> float:
        """When the tick that has begun must be over; the next should then begin."""
        return self._start + len(self._late_s) * self._tick_s

    def jitter_ms(self) -> dict[str, float | None]:
        """How long after its time a tick began: mean, 99th percentile and maximum."""
        if not self._late_s:
            return {"mean": None, "p99": None, "max": None}
        late = np.frombuffer(self._late_s, dtype=np.float32) * 1e3
        return {
            "mean": float(late.mean(dtype=np.float64)),
            "p99": float(np.percentile(late, 99)),
            "max": float(late.max()),
        }
