"""Error feedback: what writing an upload more coarsely takes from a model is kept and added to the next upload.

With w the model, e what is kept and Q the coding, a UAV sends q = Q(w + e) and keeps e ← w + e − q (Seide et al. 2014;
Karimireddy et al. 2019). So Σ q = Σ w − e: what was ever sent is what was ever meant, but for the last residual. Whole
models are sent, which a leader can average without knowing what went before, and e never exceeds what one rounding
takes: an upload or a broadcast lost in an outage costs the federation that much at most, and nobody has to notice.
"""

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.state import Floats
from meanflock.swarm.wire.payload import Coding


class Feedback:
    """The residuals of M rows, if they are kept at all."""

    def __init__(self, coding: Coding, rows: int, *, kept: bool) -> None:
        self.residuals: Floats | None = np.zeros((rows, coding.floats)) if kept else None  # (M, L)
        self._coding = coding

    def encode(self, rows: NDArray[np.intp], models: Floats) -> NDArray[np.generic]:
        """What `rows` (S,) upload for their `models` (S, L); what cannot be sent leaves no residual.

        The residuals are replaced, never written to: who has kept those of before can put them back.
        """
        if self.residuals is None:
            return self._coding.encode(models)
        meant = models + self.residuals[rows]
        payload = self._coding.encode(meant)
        sound = self._coding.sound(payload)
        self.residuals = self.residuals.copy()
        self.residuals[rows[sound]] = meant[sound] - self._coding.decode(payload[sound])
        return payload
