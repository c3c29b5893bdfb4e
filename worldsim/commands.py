"""What the agents command and tell of themselves: the numbers of their answers, each in the row of its UAV."""

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarm import model, state
from swarm.messages import DIAGNOSTICS, OUTCOME_FLOATS
from worldsim.members import Member

Uavs: TypeAlias = NDArray[np.intp]

_NOBODY: Uavs = np.zeros(0, dtype=np.intp)


class Commands:
    """The commands that hold, and the diagnostics of the last tick.

    accelerations: (N, 2), m/s²; who says nothing goes on as before. diagnostics: (N, 3), zeros of who says nothing.
    residuals: the largest |e_H| and |e_F| of the tick. of_everyone: whether all answered, one after the other.
    """

    def __init__(self, uavs: int) -> None:
        self.accelerations: state.Plane = np.zeros((uavs, state.AXES))
        self.diagnostics = np.zeros((uavs, len(DIAGNOSTICS)))
        self.residuals = (0.0, 0.0)
        self._everyone = np.arange(uavs)
        self._names: list[str] = []  # who answered last,
        self._uavs = _NOBODY  # and for whom
        self.of_everyone = False

    def enter(
        self, asked: Mapping[str, Member], outcomes: Mapping[str, bytes], awake: NDArray[np.bool_] | None
    ) -> Uavs:
        """Takes the outcomes of nodes, each (M, 5); returns the UAVs whose are beyond all bounds, which are not taken.

        `awake`: (N,), whose are; None for everyone's.
        """
        names = [name for name in asked if outcomes.get(name)]  # a leader's is empty
        if names != self._names:  # as a rule they are those of the last tick
            self._names, self._uavs = names, np.concatenate([_NOBODY, *[asked[name].uavs for name in names]])
            self.of_everyone = np.array_equal(self._uavs, self._everyone)
        said = [outcomes[name] for name in names]
        outcome = np.frombuffer(b"".join(said)).reshape(-1, OUTCOME_FLOATS)
        sane = (np.abs(outcome) < model.BEYOND_SENSE).all(axis=-1)  # NaN is below nothing
        taken = sane if awake is None else sane & awake[self._uavs]
        rows, numbers = self._uavs[taken], outcome[taken]
        self.accelerations[rows], told = numbers[:, : state.AXES], numbers[:, state.AXES :]
        self.diagnostics[...] = 0.0
        self.diagnostics[rows] = told
        hjb, fpk, _ = np.abs(told).max(axis=0, initial=0.0).tolist()
        self.residuals = hjb, fpk
        return self._uavs[~sane]
