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

class Turn:
    def __init__(
        self,
        tables: object,
        bound: float,
        kinds: tuple[tuple[tuple[bytes, ...], tuple[bytes, ...]], ...],
        value: NDArray[Any],
        density: NDArray[Any],
        value_out: NDArray[Any],
        density_out: NDArray[Any],
        /,
    ) -> None: ...
    def answer(self, raw: bytes, tick: int, /) -> bytes | None: ...
