"""Progress of a call of the Python API, of which it tells a function of its caller."""

import inspect
from collections.abc import Callable

from meanflock.swarm.errors import BadInput

Progress = Callable[[int, int], None]  # what is done, and all there is to do: ticks, or flights


def checked_progress(progress: Progress | None) -> Progress:
    """The function to tell; None: one that does nothing.

    Raises:
        BadInput: it is no function of two arguments.
    """
    if progress is None:
        return _tell_nobody
    try:
        inspect.signature(progress).bind(0, 0)
    except (TypeError, ValueError) as error:
        raise BadInput(
            f"progress: {progress!r}; give a function of two numbers, what is done and all, such as print"
        ) from error
    return progress


def _tell_nobody(_done: int, _all: int) -> None:
    pass
