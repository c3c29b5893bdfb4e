"""The state of a flight: what a checkpoint stores of its parts.

A part names the attributes that it keeps. Their types and shapes are those of a part that has just been made, so none
is declared twice.
"""

from collections import Counter
from typing import Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.plugins.guard import check_same_form
from meanflock.swarm.seeds import random_state, set_random_state


class Stateful:
    """Base class of a part of a flight.

    stored: its attributes that a checkpoint stores: numbers, bytes, sets, counters, arrays of a fixed shape, dicts of
        arrays, generators, parts, lists of parts. A property may have structs, too; it is set to lists of their fields.
    """

    stored: ClassVar[tuple[str, ...]] = ()

    def settle(self) -> None:
        """Bring the attributes up to date, before they are stored."""

    def restored(self) -> None:
        """Set what follows from the attributes, after they were restored."""


def state_of(part: Stateful) -> dict[str, Any]:
    """All that a checkpoint stores of a part, by name. Arrays may be the part's own: encode it before the next tick."""
    part.settle()
    return {name: _plain(getattr(part, name)) for name in part.stored}


def restore(part: Stateful, state: Any) -> None:
    """Continue with what `state_of` returned.

    Raises:
        TypeError, ValueError, KeyError: something is missing, or of another type or shape.
    """
    for name in part.stored:
        if isinstance(getattr(type(part), name, None), property):
            setattr(part, name, state[name])
        else:
            setattr(part, name, _like(name, getattr(part, name), state[name]))
    part.restored()


def _plain(value: Any) -> Any:
    """A value that `encode_record` can write."""
    if isinstance(value, Stateful):
        return state_of(value)
    if isinstance(value, np.random.Generator):
        return random_state(value)
    if isinstance(value, msgspec.Struct):
        return _plain(msgspec.structs.astuple(value))
    if isinstance(value, dict):
        return {name: _plain(inner) for name, inner in value.items()}
    if isinstance(value, set):
        return sorted(value)
    return [_plain(inner) for inner in value] if isinstance(value, list | tuple) else value


def _like(name: str, now: Any, stored: Any) -> Any:
    """A stored value, as the attribute that is `now`; raises TypeError or ValueError if it cannot be one."""
    if isinstance(now, Stateful):
        restore(now, stored)
        return now
    if isinstance(now, np.random.Generator):
        set_random_state(now, stored)
        return now
    if isinstance(now, np.ndarray):
        return _array(name, now, stored)
    if isinstance(now, Counter):
        return Counter(dict(stored))
    if isinstance(now, dict):
        check_same_form(name, stored, now)
        return {key: np.array(array) for key, array in stored.items()}
    if isinstance(now, set):
        return {tuple(one) if isinstance(one, list) else one for one in stored}
    if isinstance(now, list):
        for inner, one in zip(now, stored, strict=True):
            restore(inner, one)
        return now
    if now is not None and stored is not None and not isinstance(stored, type(now)):
        raise TypeError(f"{name} is a {type(stored).__name__}, expected {type(now).__name__}")
    return stored


def _array(name: str, now: NDArray[Any], stored: Any) -> NDArray[Any]:
    if not isinstance(stored, np.ndarray) or stored.shape != now.shape:
        raise ValueError(f"{name} has the shape {np.shape(stored)}, expected {now.shape}")
    return stored.astype(now.dtype)
