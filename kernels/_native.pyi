from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.wire import Message

SOURCES: int  # `kernels.sources.checksum` of what it was built from

def tables(numbers: NDArray[np.float64], indices: NDArray[np.int32]) -> Any: ...
def learn(
    tables: Any,
    states: NDArray[np.float64],
    weights: NDArray[np.float64],
    around: NDArray[np.float64] | None,
    weights_out: NDArray[np.float64],
    numbers: NDArray[np.float64],
) -> None: ...
def pairs(
    states: NDArray[np.float64], hazard_m: float, collision_m: float, found: NDArray[np.intp]
) -> tuple[float, int, int, float]: ...
def nearest(
    wanted: NDArray[np.float64],
    normals: NDArray[np.float64],
    bounds: NDArray[np.float64],
    limit: float,
    found: NDArray[np.float64],
    missing: NDArray[np.float64],
) -> None: ...
def columns(
    left: NDArray[np.float64], right: NDArray[np.float64] | None, out: NDArray[np.float64], first: int
) -> float: ...
def repel(
    states: NDArray[np.float64],
    known: NDArray[np.float64],
    weight: float,
    range_m: float,
    pushed: NDArray[np.float64],
) -> None: ...
def read(raw: bytes, kind: int = 0, into: NDArray[np.float64] | None = None, /) -> Message: ...
def write(
    kind: int,
    run: int,
    tick: int,
    flags: int,
    rows: int,
    columns: int,
    table: Any,
    tables: tuple[Any, ...],
    frames: Sequence[tuple[int, int, int, int, Any, Any, Any]] = (),
    /,
) -> bytes: ...
