from typing import Any

from numpy.typing import NDArray

def advance(
    constants: bytes,
    n: int,
    measures: bool,
    states: NDArray[Any],
    status: NDArray[Any],
    accelerations: NDArray[Any],
    gust: NDArray[Any] | None,
    noise: NDArray[Any],
    moved: NDArray[Any],
    energy: NDArray[Any],
    distance: NDArray[Any],
    speed_sum: NDArray[Any],
    ticks_on_way: NDArray[Any],
    numbers: NDArray[Any],
    marks: NDArray[Any],
) -> int: ...
def distances(columns: NDArray[Any]) -> float: ...
def near(columns: NDArray[Any], reach: float, most: float, least: float) -> tuple[int, bytes]: ...
def enter(
    said: list[bytes], bound: float, accelerations: NDArray[Any], diagnostics: NDArray[Any]
) -> tuple[float, float] | None: ...
def spread(models: NDArray[Any], n: int, width: int, bound: float) -> float | None: ...
