"""What UAVs have learned, and what a tick of learning comes to. All arrays are rows."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent import weights as model
from swarm import state

OUTCOME_FLOATS = 5

Floats = NDArray[np.float64]


class Minds(msgspec.Struct, frozen=True, eq=False):
    """What M UAVs have learned: value (M, 2, 54), density (M, 2, 69)."""

    value: Floats
    density: Floats

    def models(self) -> Floats:
        """Whole models in the order of the radio, `(M, 246)`."""
        rows = len(self.value)
        return np.concatenate([self.value.reshape(rows, -1), self.density.reshape(rows, -1)], axis=-1)

    def with_models(self, rows: NDArray[np.intp], part: slice, vectors: Floats) -> "Minds":
        """The same minds, the `part` of the models of `rows` overwritten by `vectors` (len(rows), L)."""
        models = self.models()
        models[rows, part] = vectors
        parts = (models[:, model.VALUE], self.value), (models[:, model.DENSITY], self.density)
        return Minds(*[np.ascontiguousarray(part).reshape(like.shape) for part, like in parts])


class Outcome(msgspec.Struct, frozen=True, eq=False):
    """One tick: minds after it, the rows [a_x, a_y, e_H, e_F, φ_G] of an Act, (M, 5), and the largest of them, |·|."""

    minds: Minds
    numbers: Floats
    largest: float  # NaN where one of them is

    @classmethod
    def of(cls, minds: Minds, accelerations: Floats, *diagnostics: Floats) -> "Outcome":
        """Puts the columns together: accelerations (M, 2), then e_H, e_F, φ_G, each (M,); zeros where left out."""
        numbers = np.zeros((len(accelerations), OUTCOME_FLOATS))
        numbers[:, : state.AXES] = accelerations
        for column, values in enumerate(diagnostics, state.AXES):
            numbers[:, column] = values
        return cls(minds, numbers, float(np.abs(numbers).max(initial=0.0)))

    @property
    def accelerations(self) -> Floats:
        """(M, 2), m/s²."""
        return self.numbers[:, : state.AXES]

    @property
    def hjb_residual(self) -> Floats:
        """e_H, (M,)."""
        return self.numbers[:, state.AXES]

    @property
    def fpk_residual(self) -> Floats:
        """e_F, (M,)."""
        return self.numbers[:, state.AXES + 1]

    @property
    def phi_g(self) -> Floats:
        """φ_G, (M,)."""
        return self.numbers[:, state.AXES + 2]
