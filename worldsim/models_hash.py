"""Hash of the models that a flight shared: equal for flights whose federations did the same, to the last bit."""

import hashlib
from collections.abc import Iterable

import numpy as np

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Frames


class ModelsHash:
    """Hash of the global models, as they are coded, in the order in which they are broadcast.

    Where no global model goes by radio, as with the topology `neighbours`, the uploads count in their place.
    """

    def __init__(self, scenario: Scenario) -> None:
        by_radio = [hop.label for hop in scenario.hops if not hop.is_local]
        self._label = by_radio[-1] if by_radio else None
        self.digest = b""  # after the models so far; empty before the first

    @property
    def hexdigest(self) -> str | None:
        """The hash as text; None if no model was sent."""
        return self.digest.hex() or None

    def add(self, frames: Iterable[Frames]) -> None:
        """Add the models among the frames of a tick, sources ascending."""
        for batch in frames:
            if batch.kind == self._label:
                form = f"{batch.round} {batch.payload.dtype.str} {batch.payload.shape}".encode()
                whole = hashlib.sha256(self.digest + form + batch.source.astype("<i4").tobytes())
                whole.update(np.ascontiguousarray(batch.payload).data)
                self.digest = whole.digest()
