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

class Sides:
    side: int
    def __init__(
        self,
        tables: object,
        bound: float,
        value: NDArray[Any],
        density: NDArray[Any],
        other_value: NDArray[Any],
        other_density: NDArray[Any],
        /,
    ) -> None: ...

class Turn:
    def __init__(
        self,
        sides: Sides,
        kinds: tuple[tuple[tuple[bytes | int, ...], tuple[bytes | int, ...]], ...],
        models: int = 0,
        coding: tuple[int, int, int, float] = ...,
        names: bytes = b"",
        /,
    ) -> None: ...
    def answer(self, raw: bytes, tick: int, number: int = 0, places: bytes = b"", /) -> bytes | None: ...
