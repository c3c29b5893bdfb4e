from typing import Any

from numpy.typing import NDArray

def tables(arrays: dict[str, NDArray[Any]]) -> object: ...
def step(
    tables: object,
    states: NDArray[Any],
    value: NDArray[Any],
    density: NDArray[Any],
    known: NDArray[Any] | None,
    value_out: NDArray[Any],
    density_out: NDArray[Any],
    numbers_out: NDArray[Any],
) -> float: ...
