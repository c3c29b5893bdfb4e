"""What plug-ins remember from one call to the next: arrays by name, of the kinds that a checkpoint keeps."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.wire.control import MAX_AXES, TRAVELS

_KINDS = ", ".join(sorted(map(str, TRAVELS)))


def check_kept(what: str, arrays: Any, rows: int | None = None) -> None:
    """Lets a dict of arrays through that a checkpoint can keep, with a leading axis of so many rows where these are
    given. `what`: as messages name it.

    Raises:
        TypeError, ValueError: it is something else; the message names the array, what came and what was expected.
    """
    if not isinstance(arrays, dict):
        raise TypeError(f"{what} is a {type(arrays).__name__}; expected a dict of arrays")
    for name, array in arrays.items():
        if not isinstance(name, str):
            raise TypeError(f"{what}[{name!r}]: its name must be a text")
        if not isinstance(array, np.ndarray) or array.dtype not in TRAVELS or array.ndim > MAX_AXES:
            came = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else f"a {type(array).__name__}"
            raise TypeError(
                f"{what}[{name!r}] is {came}; a checkpoint keeps arrays of {_KINDS}, with at most {MAX_AXES} axes"
            )
        if rows is not None and array.shape[:1] != (rows,):
            raise ValueError(f"{what}[{name!r}] has shape {array.shape}; expected a leading axis of {rows} rows")


def check_again(what: str, after: Any, before: Mapping[str, NDArray[Any]]) -> None:
    """Lets through what has the arrays that were there `before`, each of the same dtype and shape.

    Raises:
        TypeError, ValueError: it has not.
    """
    if not isinstance(after, dict):
        raise TypeError(f"{what} is a {type(after).__name__}; expected a dict of arrays")
    if after.keys() != before.keys():
        raise ValueError(f"{what} has {sorted(map(str, after))}; of `init` it had {sorted(before)}")
    for name, array in after.items():
        was = before[name]
        if array is not was and (
            not isinstance(array, np.ndarray) or array.dtype != was.dtype or array.shape != was.shape
        ):
            came = f"{np.shape(array)} {getattr(array, 'dtype', type(array).__name__)}"
            raise ValueError(f"{what}[{name!r}] is {came}; of `init` it was {was.shape} {was.dtype}")
