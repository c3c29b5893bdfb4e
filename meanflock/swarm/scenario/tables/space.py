"""Table of space: the number of axes of a flight, and vectors of keys with that many numbers."""

from functools import cache
from typing import Annotated, Literal

import numpy as np

from meanflock.swarm.scenario.described import OURS, PRINTED, key
from meanflock.swarm.state import Vectors
from meanflock.swarm.toml import Table as _Table


class Space(_Table, frozen=True):
    """Number of axes of a flight: in the plane, or in space with z upward from the ground; and limits of altitude."""

    dimensions: Annotated[
        Literal[2, 3],
        key(
            "number of axes of the flight; 2: a plane at the altitude `start.height`; 3: space, the ground at z = 0",
            PRINTED,
            "the paper flies in the plane",
            later=True,
        ),
    ] = 2
    floor: (
        Annotated[
            float,
            key(
                "lowest altitude of UAVs; filters, `orca` and `bvc` keep above it, and UAVs that go below are "
                "counted; unset: none",
                OURS,
                "the paper has no limits of altitude",
                unit="m",
                later=True,
                ge=0,
            ),
        ]
        | None
    ) = None
    ceiling: (
        Annotated[
            float,
            key(
                "highest altitude of UAVs, likewise; unset: none",
                OURS,
                "likewise",
                unit="m",
                later=True,
                gt=0,
            ),
        ]
        | None
    ) = None

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """The limits of altitude that are set, each with its side: 1 and the floor, −1 and the ceiling, m."""
        sides = ((1.0, self.floor), (-1.0, self.ceiling))
        return tuple((side, limit) for side, limit in sides if limit is not None)

    def vector(self, given: tuple[float, ...], upward: float = 0.0) -> Vectors:
        """A vector (d,) from the numbers of a key; `upward` is its z if the key has none. Read-only."""
        return _vector(self.dimensions, given, upward)

    def vectors(self, given: tuple[tuple[float, ...], ...], upward: float = 0.0) -> Vectors:
        """Vectors (K, d), as `vector`."""
        numbers = [(*one, upward)[: self.dimensions] for one in given]
        return np.array(numbers, dtype=np.float64).reshape(-1, self.dimensions)


@cache
def _vector(dimensions: int, given: tuple[float, ...], upward: float) -> Vectors:
    vector = np.array((*given, upward)[:dimensions], dtype=np.float64)
    vector.flags.writeable = False
    return vector
