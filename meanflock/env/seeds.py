"""Seeds of the flights of an environment."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from meanflock.swarm import toml
from meanflock.swarm.counts import count_of
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario

_MOST = 2**62  # the bound of the key `seed`
_FRESH_BYTES = 6  # a float holds such a seed, as in JSON of other programs


class Seeds:
    """The seeds of the next flights: those after the last given seed, or fresh ones of the system if none was given."""

    def __init__(self, first: int | None) -> None:
        self._next = first

    def take(self) -> int:
        """The seed of the next flight."""
        if self._next is None:
            return _fresh()
        seed, self._next = self._next, self._next + 1
        return seed

    def begin(self, seed: Any, flights: int) -> list[int]:
        """The seeds of flights that begin together.

        Args:
            seed: that of the first, the others follow on; or one for each flight, None for a fresh one; or None for the
                next ones.

        Raises:
            BadInput: it cannot be used.
        """
        if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str) and np.ndim(seed):
            if len(seed) != flights:
                raise BadInput(
                    f"reset: {len(seed)} seeds; give one for each of the {flights} flights, or one seed: flight f has "
                    "seed + f"
                )
            chosen = [None if one is None else _checked(one) for one in seed]
            given = [one for one in chosen if one is not None]
            self._next = max(given) + 1 if given else None
            return [_fresh() if one is None else one for one in chosen]
        if seed is not None:
            self._next = _checked(seed)
        return [self.take() for _ in range(flights)]


def seed_of(mission: str | Path | Scenario | None, argument: Any) -> int | None:
    """The seed of the first flight: the argument `seed`, else that of a Scenario, or of a file; None: it has none.

    Raises:
        BadInput: the argument is no seed, or the file cannot be read.
    """
    if argument is not None:
        return count_of("seed:", argument, 0, _MOST)
    if isinstance(mission, Scenario):
        return mission.seed
    if mission is not None and Path(mission).suffix:
        return toml.read(Path(mission), "scenario").get("seed")
    return None


def _checked(seed: Any) -> int:
    return count_of("reset: seed:", seed, 0, _MOST)


def _fresh() -> int:
    return int.from_bytes(os.urandom(_FRESH_BYTES), "big")
