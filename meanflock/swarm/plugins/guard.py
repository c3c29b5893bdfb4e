"""Checks of the results of plug-ins of every kind. Callers check a result before they use it.

Each error names the value, what it is, and what was expected. The caller adds the name of the plug-in.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from meanflock.swarm.state import BEYOND_SENSE, Floats, Mask
from meanflock.swarm.wire.control import MAX_AXES, TRAVELS

_KINDS = ", ".join(sorted(map(str, TRAVELS)))
_AXES = MAX_AXES - 1  # of an array of a plug-in; a node may store one for each of its UAVs


def check_values(method: str, answer: Any, count: int, expected: str) -> tuple[Any, ...]:
    """Check that a method returned a tuple of so many values, and return it.

    Raises:
        TypeError: it returned something else.
    """
    if not isinstance(answer, tuple) or len(answer) != count:
        raise TypeError(f"`{method}` returns a {type(answer).__name__}; expected {expected}")
    return answer


def check_array(label: str, array: Any, shape: tuple[int, ...], dtype: DTypeLike) -> None:
    """Check that a value is an array of a shape and a dtype.

    Raises:
        TypeError: it is something else.
    """
    if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != dtype:
        raise TypeError(f"{label}: {_form(array)}, expected {np.dtype(dtype)} {shape}")


def as_floats(label: str, table: Any, shape: tuple[int, ...]) -> Floats:
    """Check that a table of real numbers has a shape, and return it as float64; complex numbers are refused.

    Raises:
        TypeError, ValueError: it is something else.
    """
    numbers = np.asarray(table)
    if numbers.dtype.kind not in "biuf":
        raise TypeError(f"{label} is {_form(table)}; expected real numbers {shape}")
    if numbers.shape != shape:
        raise ValueError(f"{label} has shape {numbers.shape}; expected {shape}")
    return numbers.astype(np.float64, copy=False)


def check_finite(label: str, array: NDArray[Any]) -> None:
    """Check that an array has finite numbers only.

    Raises:
        ValueError: it has others.
    """
    if not np.isfinite(array).all():
        raise ValueError(f"{label} is not finite")


def check_bounded(label: str, array: NDArray[Any], most: float = BEYOND_SENSE) -> None:
    """Check that the numbers of an array are finite and smaller than `most` in size.

    Raises:
        ValueError: a number is not; the text has it.
    """
    if not max(array.max(initial=0.0), -array.min(initial=0.0)) < most:  # false for NaN
        check_finite(label, array)
        number = array[np.abs(array) >= most][0]
        raise ValueError(f"{label} has {number:g}; expected numbers within ±{most:g}")


def bounded_rows(array: NDArray[Any], most: float = BEYOND_SENSE) -> Mask:
    """Mask of the rows that pass `check_bounded`, each alone."""
    table = array.reshape(len(array), -1)
    largest = np.maximum(table.max(axis=1, initial=0.0), -table.min(axis=1, initial=0.0))
    return np.asarray(largest < most)


def check_memory(label: str, memory: Any, rows: int | None = None) -> None:
    """Check that a memory is a dict of arrays that a checkpoint can hold, each with a leading axis of `rows` if given.

    Raises:
        TypeError, ValueError: it is something else.
    """
    _check_dict(label, memory)
    for name, array in memory.items():
        if not isinstance(name, str) or not name.isprintable():
            raise TypeError(f"{label}[{name!r}]: its name must be a printable text")
        if not isinstance(array, np.ndarray) or array.dtype not in TRAVELS or array.ndim > _AXES:
            allowed = f"arrays of {_KINDS}, with at most {_AXES} axes"
            raise TypeError(f"{label}[{name!r}] is {_form(array)}; a checkpoint keeps {allowed}")
        if rows is not None and array.shape[:1] != (rows,):
            raise ValueError(f"{label}[{name!r}] has shape {array.shape}; expected a leading axis of {rows} rows")


def check_same_form(label: str, after: Any, before: Mapping[str, NDArray[Any]]) -> None:
    """Check that a memory has the arrays that it had `before`, each of the same dtype and shape.

    Raises:
        TypeError, ValueError: it does not.
    """
    _check_dict(label, after)
    if after.keys() != before.keys():
        raise ValueError(f"{label} has {sorted(map(str, after))}; of `init` it had {sorted(before)}")
    for name, array in after.items():
        first = before[name]
        if array is not first and (
            not isinstance(array, np.ndarray) or array.dtype != first.dtype or array.shape != first.shape
        ):
            found = f"{np.shape(array)} {getattr(array, 'dtype', type(array).__name__)}"
            if not isinstance(array, np.ndarray):
                found += ", no array"
            raise ValueError(f"{label}[{name!r}] is {found}; of `init` it was {first.shape} {first.dtype}")


def _check_dict(label: str, arrays: Any) -> None:
    if not isinstance(arrays, dict):
        raise TypeError(f"{label} is a {type(arrays).__name__}; expected a dict of arrays")


def _form(value: Any) -> str:
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"
