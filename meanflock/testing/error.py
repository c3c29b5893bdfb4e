"""What a check raises, and what checks have in common."""

import random
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NoReturn, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")


class ConformanceError(AssertionError):
    """A plug-in does not keep what a flight relies on; the text says what to mend."""


def fail(of: type, what: str, mend: str) -> NoReturn:
    """Raises ConformanceError."""
    raise ConformanceError(f"{of.__name__}: {what}; {mend}")


def text_of(error: BaseException) -> str:
    """An exception in a line."""
    return f"{type(error).__name__}: {error}"


def make(of: type, options: Mapping[str, Any], *context: Any) -> Any:
    """An instance with such options, as a flight makes it."""
    for attribute in ("name", "Options"):
        if not getattr(of, attribute, None):
            fail(of, f"it has no `{attribute}`", "derive it from the base class of its door and give it a name")
    try:
        return of(msgspec.convert(dict(options), of.Options), *context)  # type: ignore[attr-defined]
    except msgspec.ValidationError as error:
        fail(of, f"its options {dict(options)} do not fit: {error}", "give every option a default, or pass `options`")


def same(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Whether two arrays have the same shape and bits; any NaN is like any other."""
    one, other = np.asarray(one), np.asarray(other)
    if one.shape != other.shape or one.dtype != other.dtype:
        return False
    if one.dtype.kind == "f" and np.isnan(one).any():
        return bool(np.array_equal(one, other, equal_nan=True))
    return one.tobytes() == other.tobytes()


def alike(one: Mapping[str, NDArray[Any]], other: Mapping[str, NDArray[Any]]) -> str | None:
    """The name of an array in which two memories differ; None if there is none."""
    if set(one) != set(other):
        return ", ".join(sorted(set(one) ^ set(other)))
    return next((name for name in one if not same(one[name], other[name])), None)


def copies(arrays: Iterable[NDArray[Any]]) -> list[NDArray[Any]]:
    """Copies of some arrays."""
    return [np.array(array) for array in arrays]


def with_other_randomness(run: Callable[[], T], seed: int) -> T:
    """Runs something with the global generators of Python and NumPy seeded, and puts them back."""
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002  # the very thing that is looked for
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002
    try:
        return run()
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002
