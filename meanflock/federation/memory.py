"""A node's memory of the models that its UAVs sent and received: rounding errors, and the last models of both."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.coding import Coding
from meanflock.federation.fragments import Pieces
from meanflock.swarm.state import Floats, Mask

_GLOBALS, _SEEN, _FRESH = "meanflock.globals", "meanflock.seen", "meanflock.fresh"  # in a checkpoint


class NodeModels(Protocol):
    """The models of a node's rows."""

    def models_to_send(self, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], Floats, Floats]:
        """The rows among these that can send, their models (S, L) and what these count (S,)."""
        ...

    def ready(self, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """The rows among these that have a model to upload."""
        ...

    def take(self, rows: NDArray[np.intp], models: Floats) -> None:
        """Puts models (S, L) in the place of those of some rows."""
        ...

    def silent(self) -> Mask:
        """The rows that send nothing in this tick, (M,)."""
        ...


class Feedback:
    """Error feedback for M rows: what coding takes from an upload is added to the row's next upload.

    With w the model, e the residual and Q the coding, a UAV sends q = Q(w + e) and sets e ← w + e − q (Seide et al.
    2014; Karimireddy et al. 2019), so Σ q = Σ w − e. Whole models are sent: a lost upload costs at most one rounding.
    """

    def __init__(self, coding: Coding, rows: int, *, active: bool) -> None:
        self.residuals: Floats | None = np.zeros((rows, coding.floats)) if active else None  # (M, L)
        self._coding = coding

    def encode(self, rows: NDArray[np.intp], models: Floats) -> NDArray[np.generic]:
        """Payloads of `rows` (S,) for their `models` (S, L); a payload that cannot be sent leaves no residual."""
        if self.residuals is None:
            return self._coding.encode(models)
        largest = self._coding.largest  # no residual pushes a model beyond it
        meant = np.clip(models + self.residuals[rows], -largest, largest)
        payload = self._coding.encode(meant)
        valid = self._coding.valid(payload)
        self.residuals[rows[valid]] = meant[valid] - self._coding.decode(payload[valid])
        return payload


class Trigger:
    """Silence of M rows whose models have hardly moved: ‖w − w_sent‖ ≤ threshold · ‖w_sent‖.

    w is the model, and w_sent the one that the row sent last; the first model always goes. Global models that a UAV
    takes move w, too.
    """

    def __init__(self, threshold: float, rows: int, parameters: int) -> None:
        self._threshold = threshold
        self.sent = np.zeros((rows, parameters))  # (M, L); 0 where nothing was sent

    def due(self, rows: NDArray[np.intp], models: Floats) -> NDArray[np.bool_]:
        """Mask (S,) of the `rows` (S,) that send their `models` (S, L); these count as sent."""
        before = self.sent[rows]
        moved, size = ((each * each).sum(axis=-1) for each in (models - before, before))
        due = np.asarray((moved > self._threshold**2 * size) | (size == 0.0))
        self.sent[rows[due]] = models[due]
        return due


class GlobalModels:
    """The last global model that each of M rows received, by fragments.

    A row fills fragments that it missed from the last global model it received, and not from its own: pieces of models
    that were trained apart do not fit together. A fragment that it never received is its own.
    """

    def __init__(self, coding: Coding, rows: int) -> None:
        assert coding.fragments is not None
        self._size, self._floats = coding.fragments.cut.size, coding.floats
        self._globals: NDArray[np.floating] = np.zeros((rows, coding.count, self._size), dtype=coding.held)
        self._seen = np.zeros((rows, coding.count), dtype=bool)  # fragments that were ever received
        self._fresh = np.zeros(rows, dtype=bool)  # rows that received any in this round

    def add(self, sent: NDArray[np.intp], rows: NDArray[np.intp], pieces: Pieces) -> None:
        """Stores fragments: `sent` (K,) of the pieces, to `rows` (K,)."""
        place = rows * self._seen.shape[1] + pieces.numbers[sent]  # in one list of all fragments of all rows
        self._globals.reshape(-1, self._size)[place] = pieces.values.take(sent, axis=0)
        self._seen.reshape(-1)[place] = True
        self._fresh[rows] = True

    def take(self, learner: NodeModels) -> None:
        """Lets the learner take over what its rows received in this round."""
        rows = np.flatnonzero(self._fresh & ~learner.silent())
        self._fresh[:] = False
        if not len(rows):
            return
        own = None
        if not self._seen[rows].all():
            rows, own, _ = learner.models_to_send(rows)
        every = self._globals if len(rows) == len(self._globals) else self._globals[rows]
        models = every.reshape(len(rows), self._seen.shape[1] * self._size)[:, : self._floats].astype(np.float64)
        if own is not None:
            seen = np.repeat(self._seen[rows], self._size, axis=1)[:, : self._floats]
            models = np.where(seen, models, own)
        if len(rows):
            learner.take(rows, models)

    def state(self) -> dict[str, NDArray[Any]]:
        """Arrays of M rows that a checkpoint keeps, and that may be written to."""
        return {_GLOBALS: self._globals, _SEEN: self._seen, _FRESH: self._fresh}
