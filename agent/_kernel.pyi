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
def answer(
    tables: object,
    bound: float,
    raw: bytes,
    tick: int,
    kinds: tuple[tuple[tuple[bytes, ...], tuple[bytes, ...]], ...],
    value: NDArray[Any],
    density: NDArray[Any],
    value_out: NDArray[Any],
    density_out: NDArray[Any],
) -> bytes | None: ...
