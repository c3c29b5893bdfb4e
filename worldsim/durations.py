"""A histogram of durations, cheap enough to be filled in every tick and whole whenever another thread reads it."""

from bisect import bisect_left

BOUNDS_S = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)


class Durations:
    """How often something took how long."""

    def __init__(self) -> None:
        self._counts = [0] * (len(BOUNDS_S) + 1)  # the last one: beyond all bounds
        self.total_s = 0.0

    def add(self, seconds: float) -> None:
        """It took that long, once more."""
        self._counts[bisect_left(BOUNDS_S, seconds)] += 1
        self.total_s += seconds

    @property
    def cumulative(self) -> list[tuple[str, int]]:
        """[upper bound in seconds, how often it took at most that]; the last bound is +Inf."""
        total, rows = 0, []
        for bound, count in zip((*BOUNDS_S, float("inf")), list(self._counts), strict=True):
            total += count
            rows.append((f"{bound:g}" if bound < float("inf") else "+Inf", total))
        return rows
