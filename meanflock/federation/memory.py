"""A node's memory of the models that its UAVs had, sent and received: the last of each, and rounding errors."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.codec import Codec, Coded, Pieces, notes_of
from meanflock.swarm.state import Floats, Mask

_GLOBALS, _SEEN, _FRESH, _HEADS = "meanflock.globals", "meanflock.seen", "meanflock.fresh", "meanflock.heads"
_WHOLE = "meanflock.whole"  # these are in a checkpoint


class NodeModels(Protocol):
    """The models of a node's rows."""

    def ready(self, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """The rows among these that have a model to upload."""
        ...

    def models_to_send(self, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], Floats, Floats]:
        """The rows among these that can send, their models (S, L) and what these count (S,)."""
        ...

    def notes(self, rows: NDArray[np.intp]) -> Sequence[bytes]:
        """Bytes that travel with the models of these rows."""
        ...

    def based(self, rows: NDArray[np.intp]) -> NDArray[np.integer] | None:
        """The rounds of the global models with which the training of these rows began, (S,); None: the round before."""
        ...

    def take(
        self,
        rows: NDArray[np.intp],
        models: Floats,
        number: int,
        whole: Mask,
        notes: Sequence[bytes],
    ) -> None:
        """Puts models (S, L) of a round in the place of those of some rows; of which all numbers have arrived is in
        `whole` (S,), and what came with them in `notes`."""
        ...

    def silent(self) -> Mask:
        """The rows that send nothing in this tick, (M,)."""
        ...


class Feedback:
    """Error feedback for M rows: what coding takes from an upload is added to the row's next upload.

    With w the model, e the residual and Q the coding, a UAV sends q = Q(w + e) and sets e ← w + e − q (Seide et al.
    2014; Karimireddy et al. 2019), so Σ q = Σ w − e. Models are sent, not changes: a lost upload costs at most one
    rounding. The e of a fragment that is not sent stays.
    """

    def __init__(self, codec: Codec, uavs: NDArray[np.intp], *, active: bool) -> None:
        """`uavs`: (M,)."""
        self.residuals: Floats | None = np.zeros((len(uavs), codec.floats)) if active else None  # (M, L)
        self._codec, self._uavs = codec, uavs

    def encode(self, rows: NDArray[np.intp], models: Floats, number: int, sent: Mask | None = None) -> Coded:
        """The `models` (S, L) of `rows` (S,) in a round, as written; one that cannot be sent leaves no residual.

        `sent`: (S, F) fragments that are sent; None: all.
        """
        if self.residuals is None:
            return self._codec.encode(models, self._uavs[rows], number)
        largest = self._codec.largest  # no residual pushes a model beyond it
        meant = np.clip(models + self.residuals[rows], -largest, largest)
        coded = self._codec.encode(meant, self._uavs[rows], number)
        valid = self._codec.valid(coded)
        errors = meant[valid] - self._codec.decode(coded.of(valid))
        if sent is not None:
            errors = np.where(self._codec.by_number(sent[valid]), errors, self.residuals[rows[valid]])
        self.residuals[rows[valid]] = errors
        return coded


class OwnModels:
    """The models of M rows when a round opened, as their coding leaves them.

    Attributes:
        models: (M, L). samples: (M,) what they count. rounds: (M,) of each, the last round in which it could be sent.
    """

    def __init__(self, codec: Codec, rows: int) -> None:
        self._codec = codec
        self.models = np.zeros((rows, codec.floats))
        self.samples = np.ones(rows)
        self.rounds = np.zeros(rows, dtype=np.int64)

    def put(self, number: int, rows: NDArray[np.intp], coded: Coded, samples: Floats) -> None:
        """Stores the models of rows (S,) in a round, but for those that cannot be sent."""
        valid = self._codec.valid(coded)
        self.models[rows[valid]] = self._codec.decode(coded.of(valid))
        self.samples[rows[valid]] = samples[valid].astype(np.float32) if self._codec.form.weighted else 1.0
        self.rounds[rows[valid]] = number


class Sent:
    """The models that M rows sent last, and what of a new model has moved enough to be sent.

    A row is silent while ‖w − w_sent‖ ≤ threshold · ‖w_sent‖. It sends the share of its F fragments that moved most, at
    least one. w is the model; the first model goes whole. Global models that a UAV takes move w, too.
    """

    def __init__(self, codec: Codec, rows: int, threshold: float, share: float = 1.0) -> None:
        self.models = np.zeros((rows, codec.floats))  # (M, L); 0 where nothing was sent
        self._threshold, self._codec = threshold, codec
        self._count = max(1, round(share * codec.count))

    def due(self, rows: NDArray[np.intp], models: Floats) -> Mask:
        """Mask (S, F) of the fragments that the `rows` (S,) send of their `models` (S, L); these count as sent."""
        before = self.models[rows]
        moved, size = ((each * each).sum(axis=-1) for each in (models - before, before))
        due = np.asarray((moved > self._threshold**2 * size) | (size == 0.0))
        fragments = np.repeat(due[:, None], self._codec.count, axis=1)
        if self._count < self._codec.count:
            by_fragment = self._codec.by_fragment((models - before) ** 2)
            order = np.argsort(-by_fragment, axis=1, kind="stable")
            chosen = np.zeros_like(fragments)
            np.put_along_axis(chosen, order[:, : self._count], True, axis=1)
            fragments &= chosen | (size == 0.0)[:, None]
        sent = self._codec.by_number(fragments)
        self.models[rows] = np.where(sent, models, before)
        return fragments


class GlobalModels:
    """The last global model that each of M rows received, by fragments.

    A row fills fragments that it missed from the last global model it received, and not from its own: pieces of models
    that were trained apart do not fit together. A fragment that it never received is its own. Where models go whole and
    once, nothing is stored.
    """

    def __init__(self, codec: Codec, rows: int, *, gathers: bool) -> None:
        """`gathers`: whether a model may come in parts or twice, so that it is taken when its round ends."""
        self.gathers = gathers
        self._codec = codec
        stored = rows if gathers else 0
        self._globals: NDArray[np.floating] = np.zeros((stored, codec.count, codec.size), dtype=codec.held)
        self._seen = np.zeros((stored, codec.count), dtype=bool)  # fragments that were ever received
        self._whole = np.zeros((stored, codec.count), dtype=bool)  # fragments that were received in this round
        self._fresh = np.zeros(stored, dtype=bool)  # rows that received any in this round
        self._heads = np.zeros((stored, codec.form.head), dtype=np.uint8)  # of this round

    def add(
        self, sent: NDArray[np.intp], rows: NDArray[np.intp], pieces: Pieces, number: int, node: NodeModels
    ) -> None:
        """Takes fragments of a round's model: `sent` (K,) of the pieces, to `rows` (K,)."""
        if not self.gathers:
            models = self._codec.model(pieces.values.take(sent, axis=0)[:, None].astype(np.float64))
            node.take(rows, models, number, np.ones(len(rows), dtype=bool), notes_of(pieces.heads[sent]))
            return
        place = rows * self._seen.shape[1] + pieces.places[sent]  # in one list of all fragments of all rows
        self._globals.reshape(-1, self._codec.size)[place] = pieces.values.take(sent, axis=0)
        self._seen.reshape(-1)[place] = True
        self._whole.reshape(-1)[place] = True
        self._fresh[rows] = True
        first = pieces.places[sent] == 0
        self._heads[rows[first]] = pieces.heads[sent[first]]

    def take(self, number: int, node: NodeModels) -> None:
        """Lets the node take over what its rows received in this round."""
        rows = np.flatnonzero(self._fresh & ~node.silent())
        whole, heads = self._whole.copy(), self._heads.copy()
        self._fresh[:] = False
        self._whole[:] = False
        self._heads[:] = 0
        if not len(rows):
            return
        own = None
        if not self._seen[rows].all():
            rows, own, _ = node.models_to_send(rows)
        every = self._globals if len(rows) == len(self._globals) else self._globals[rows]
        models = self._codec.model(every).astype(np.float64)
        if own is not None:
            models = np.where(self._codec.by_number(self._seen[rows]), models, own)
        if len(rows):
            node.take(rows, models, number, np.logical_and.reduce(whole[rows], axis=1), notes_of(heads[rows]))

    def state(self) -> dict[str, NDArray[Any]]:
        """Arrays of M rows that a checkpoint keeps, and that may be written to."""
        if not self.gathers:
            return {}
        return {
            _GLOBALS: self._globals,
            _SEEN: self._seen,
            _WHOLE: self._whole,
            _FRESH: self._fresh,
            _HEADS: self._heads,
        }
