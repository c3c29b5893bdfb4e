"""What a controller reports of itself in flight, as its class or a time series of it says, and what of it is drawn."""

from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from meanflock.groundstation.results.series import diagnostics_in
from meanflock.swarm.declared import Declared

PHI_G = "phi_G"  # where it is reported, it colours the map
MOST_LINES = 60  # of the plot of the weights


class Reported(NamedTuple):
    """diagnostics: names of what every UAV reports in every tick. weights: floats of what it has learned."""

    diagnostics: tuple[str, ...]
    weights: int

    @classmethod
    def by(cls, declared: Declared) -> "Reported":
        """What a class declares."""
        return cls(declared.diagnostics, declared.weights)

    @classmethod
    def within(cls, rows: pa.Table) -> "Reported":
        """What a time series holds, of a controller that need not be installed here."""
        sizes = pc.list_value_length(rows["leader_model"].drop_null())  # of a run without reports there are none
        return cls(diagnostics_in(rows.schema), sizes[0].as_py() if len(sizes) else 0)

    @property
    def drawn(self) -> NDArray[np.intp]:
        """Which of the weights are drawn: all, or some that are evenly far from each other."""
        return np.unique(np.linspace(0, self.weights - 1, min(self.weights, MOST_LINES)).round().astype(np.intp))

    @property
    def has_phi_g(self) -> bool:
        """Whether trails are coloured by φ_G; else they are by speed."""
        return PHI_G in self.diagnostics
