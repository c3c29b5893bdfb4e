"""Whether a process that died is started again, so that one that cannot live is not started for ever."""

import time
from collections import Counter
from collections.abc import Callable, Hashable

QUICK_S = 10.0  # a death so soon after the start speaks against another
AT_MOST = 5  # of those in a row


class Restarts:
    """The deaths of some processes, each known by a name."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._since: dict[Hashable, float] = {}
        self._quick: Counter[Hashable] = Counter()

    def started(self, name: Hashable) -> None:
        """One of them was started."""
        self._since[name] = self._clock()

    def again(self, name: Hashable) -> bool:
        """Whether it, which has died, is worth another start."""
        if self._clock() - self._since[name] >= QUICK_S:
            self._quick[name] = 0
        self._quick[name] += 1
        return self._quick[name] <= AT_MOST
