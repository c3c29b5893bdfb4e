from typing import Any

from numpy.typing import NDArray

def carry(
    normal: NDArray[Any],
    xi: float,
    chi: float,
    threshold: NDArray[Any],
    needed: int,
    most: int,
    begun: bool,
    slots: NDArray[Any],
    missing: NDArray[Any],
) -> tuple[int, int]: ...
def account(
    template: NDArray[Any],
    tick: int,
    slots: NDArray[Any],
    missing: NDArray[Any],
    first: NDArray[Any],
    record: NDArray[Any],
) -> tuple[int, int, int]: ...
def within(states: NDArray[Any], diagonal_squared: float) -> bool: ...
