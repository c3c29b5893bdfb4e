"""Counts that Python code hands to meanflock: of an argument, or of a declaration of a plug-in."""

import operator
from typing import Any

from meanflock.swarm.errors import BadInput


def count_of(label: str, value: Any, least: int, most: int | None = None, expected: str = "") -> int:
    """A count as an int. It may be of any type that `operator.index` takes, as NumPy's integers are, but no bool.

    Args:
        label: what has the value, for the error. least, most: bounds. expected: what the error says that is expected;
            by default the bounds.

    Raises:
        BadInput: it is no whole number, or out of bounds.
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or isinstance(value, bool) or number < least or (most is not None and number > most):
        bounds = (
            f"expected a whole number of {least} … {most}"
            if most is not None
            else f"expected a whole number of at least {least}"
        )
        raise BadInput(f"{label} {value!r}; {expected or bounds}")
    return number
