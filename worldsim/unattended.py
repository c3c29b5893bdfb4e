"""UAVs whose agent was lost in flight and that no other has taken over yet."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray


class Unattended:
    """Each such UAV, and since when. Losses of the fault script are no such: the scenario wants them."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """`clock`: seconds, monotonic."""
        self._clock = clock
        self._since: dict[int, float] = {}

    def lose(self, uavs: NDArray[np.intp]) -> None:
        """The agent of these UAVs is gone."""
        self._since.update(dict.fromkeys(uavs.tolist(), self._clock()))

    def attend(self, uavs: NDArray[np.intp]) -> None:
        """These UAVs have an agent again."""
        for uav in uavs.tolist():
            self._since.pop(uav, None)

    def __bool__(self) -> bool:
        return bool(self._since)

    def any_since(self, within_s: float) -> bool:
        """Whether any of them lost its agent less than so many seconds ago: another may be on its way."""
        return bool(self._since) and self._clock() - max(self._since.values()) < within_s
