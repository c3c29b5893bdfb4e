"""The forms of the reader and the writer of a tick's messages, of the same signatures and under the same tests."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

from meanflock.kernels import reference, wire


class Backend(NamedTuple):
    """`read` and `write` of one form."""

    read: Callable[..., wire.Message]
    write: Callable[..., bytes]


REFERENCE = Backend(wire.read, wire.write)
BACKENDS: dict[str, Backend] = {"NumPy": Backend(reference.read, reference.write)}
with suppress(ImportError):  # where there was no C compiler
    from meanflock.kernels import compiled

    BACKENDS["compiled"] = Backend(compiled.read, compiled.write)


def outcome(call: Callable[..., Any], *given: Any) -> Any:
    """What a call returns, or the reason with which it rejects what it was given."""
    try:
        return call(*given)
    except ValueError as error:
        return str(error).partition(":")[0]
