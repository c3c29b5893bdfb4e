"""Work beside the thread that flies: that which waits for a disk.

Not what computes in many small steps: each of them hands Python's lock over, which costs the flight more than the step.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any


class BackgroundWorker:
    """One piece of work at a time, in order; who brings the next before it is done waits. Nothing is left undone."""

    def __init__(self, name: str) -> None:
        """`name`: of the thread, which begins with the first work."""
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._doing: Future[None] | None = None

    def do(self, work: Callable[..., None], *given: Any) -> None:
        """Begins a piece of work when that before is done. Raises what that raised, and then begins nothing."""
        self.wait()
        self._doing = self._pool.submit(work, *given)

    def look(self) -> None:
        """Raises what the work that was begun last raised, if it has by now."""
        if self._doing is not None and self._doing.done():
            self.wait()

    def wait(self) -> None:
        """Until all is done. Raises what the work that was begun last raised, once."""
        doing, self._doing = self._doing, None
        if doing is not None:
            doing.result()

    def close(self) -> None:
        """`wait`, and no further work."""
        try:
            self.wait()
        finally:
            self._pool.shutdown()
