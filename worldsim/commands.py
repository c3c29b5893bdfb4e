"""What the agents command and tell of themselves: the numbers of their answers, each in the row of its UAV."""

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarm import model, state
from swarm.messages import DIAGNOSTICS, OUTCOME_FLOATS
from worldsim.members import Member

Uavs: TypeAlias = NDArray[np.intp]

_ALL = slice(None)
_NOBODY: Uavs = np.zeros(0, dtype=np.intp)


class Commands:
    """The commands that hold, and the diagnostics of the last tick.

    accelerations: (N, 2), m/s²; who says nothing goes on as before. diagnostics: (N, 3), zeros of who says nothing.
    residuals: the largest |e_H| and |e_F| of the tick.
    """

    def __init__(self, uavs: int) -> None:
        self.accelerations: state.Plane = np.zeros((uavs, state.AXES))
        self.diagnostics = np.zeros((uavs, len(DIAGNOSTICS)))
        self.residuals = (0.0, 0.0)
        self._everyone = np.arange(uavs)
        self._names: list[str] = []  # who answered in the last tick,
        self._uavs = _NOBODY  # and for whom;
        self._rows: slice | Uavs = _NOBODY  # the same, where that is everyone in their order without numbers

    def enter(
        self, asked: Mapping[str, Member], outcomes: Mapping[str, bytes], awake: NDArray[np.bool_] | None
    ) -> Uavs:
        """Takes the outcomes of nodes, each (M, 5); returns the UAVs whose are beyond all bounds, which are not taken.

        `awake`: (N,), whose are; None for everyone's.
        """
        self.diagnostics[...] = 0.0
        self.residuals = (0.0, 0.0)
        names = list(asked) if len(outcomes) == len(asked) else [name for name in asked if name in outcomes]
        if not names:
            return _NOBODY
        if names != self._names:  # as a rule they are those of the last tick
            self._names, self._uavs = names, np.concatenate([asked[name].uavs for name in names])
            self._rows = _ALL if np.array_equal(self._uavs, self._everyone) else self._uavs
        outcome = np.frombuffer(b"".join(map(outcomes.__getitem__, names))).reshape(-1, OUTCOME_FLOATS)
        if not len(outcome):
            return _NOBODY
        largest = np.maximum.reduce(np.abs(outcome)).tolist()
        if awake is None and all(size < model.BEYOND_SENSE for size in largest):  # NaN is below nothing
            self._take(self._rows, outcome, largest)
            return _NOBODY
        sane = (np.abs(outcome) < model.BEYOND_SENSE).all(axis=-1)
        taken = sane if awake is None else sane & awake[self._uavs]
        if taken.any():
            self._take(self._uavs[taken], outcome[taken], np.abs(outcome[taken]).max(axis=0).tolist())
        return self._uavs[~sane]

    def _take(self, rows: slice | Uavs, outcome: NDArray[np.float64], largest: list[float]) -> None:
        self.accelerations[rows] = outcome[:, : state.AXES]
        self.diagnostics[rows] = outcome[:, state.AXES :]
        self.residuals = largest[state.AXES], largest[state.AXES + 1]
