"""Threads of the numeric libraries that plug-ins call: BLAS, OpenMP and torch.

A flight uses one thread. Many processes share the cores, and sums in several threads have other bits. A process of a
swarm sets variables before these libraries are loaded (`one_thread.py`). A flight in the user's process limits the
libraries while it flies, and then sets the user's numbers again. Libraries that are loaded already are found on Linux
only; torch is found everywhere.
"""

import os
import re
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ContextDecorator, contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Self

TORCH_ISA = "ATEN_CPU_CAPABILITY"  # variable with the instruction set of torch's kernels
_MAPS = Path("/proc/self/maps")  # the files that this process has loaded
_LIBRARY = re.compile(r"(?:openblas|blis|mkl_rt|gomp|iomp|libomp).*\.so")
# Functions that read and set the number of threads, and whether the number is one of each thread.
_FUNCTIONS = (
    *(
        (f"{prefix}openblas_get_num_threads{suffix}", f"{prefix}openblas_set_num_threads{suffix}", False)
        for prefix in ("", "scipy_")
        for suffix in ("", "64_", "_64")
    ),
    ("bli_thread_get_num_threads", "bli_thread_set_num_threads", False),
    ("MKL_Get_Max_Threads", "MKL_Set_Num_Threads", False),
    ("omp_get_max_threads", "omp_set_num_threads", True),
)


class Pool(NamedTuple):
    """The threads of a library. get, set: their number. of_thread: whether each thread of Python has a number."""

    name: str
    get: Callable[[], int]
    set: Callable[[int], Any]
    of_thread: bool


class _Scope:
    """The limits of this process or thread, and the numbers of its pools before the outermost one.

    limits: the innermost last. modules: number of modules that were loaded when the last pools were limited.
    """

    def __init__(self) -> None:
        self.limits: list[limited] = []
        self.modules = 0
        self._before: dict[str, tuple[Pool, int]] = {}

    def limit(self, pools: list[Pool]) -> None:
        """Set the number of the innermost limit."""
        self.modules = _modules
        new = {pool.name: (pool, pool.get()) for pool in pools if pool.name not in self._before}
        self._before |= new  # all are read before one is set: torch has the number of OpenMP
        for pool in pools:
            pool.set(self.limits[-1].number)

    def leave(self, limit: "limited") -> None:
        """End a limit; set the number of the one around it, or the numbers before."""
        if limit not in self.limits:  # another thread has closed the generator that began it
            return
        self.limits.remove(limit)
        for pool, number in self._before.values():
            pool.set(self.limits[-1].number if self.limits else number)
        if not self.limits:
            self._before.clear()


class _ThreadScope(threading.local):
    """The scope of a thread of Python."""

    def __init__(self) -> None:
        self.scope = _Scope()


_lock = threading.Lock()
os.register_at_fork(before=_lock.acquire, after_in_parent=_lock.release, after_in_child=_lock.release)
_common, _own = _Scope(), _ThreadScope()
_found: list[Pool] = []
_modules = -1  # number of modules that were loaded when pools were searched


class limited(ContextDecorator):
    """Context, and decorator, in which the numeric libraries use so many threads. Contexts may be nested."""

    def __init__(self, number: int = 1) -> None:
        self.number = number

    def __enter__(self) -> Self:
        with _lock:
            for scope in (_common, _own.scope):
                scope.limits.append(self)
            _limit()
        return self

    def __exit__(self, *failure: object) -> None:
        with _lock:
            for scope in (_common, _own.scope):
                scope.leave(self)


@contextmanager
def pinned_torch() -> Iterator[None]:
    """Context that imports plug-ins: torch takes the kernels of every processor for good, unless its variable is set.

    Torch reads the variable when it first computes.
    """
    is_given = TORCH_ISA in os.environ
    os.environ.setdefault(TORCH_ISA, "default")
    try:
        yield
    finally:
        torch = sys.modules.get("torch")
        if torch is not None and hasattr(torch, "backends"):
            torch.backends.cpu.get_cpu_capability()
        if not is_given:
            del os.environ[TORCH_ISA]


def renew_if_loaded() -> None:
    """Limit the libraries of modules that were loaded since; quick, for every tick."""
    if _own.scope.modules != len(sys.modules):
        renew()


def renew() -> None:
    """Limit all libraries again, because a plug-in that was made may have loaded some, or have set a number.

    Outside of any limit, in a process of a swarm, torch is limited for good.
    """
    with _lock:
        if _own.scope.limits:
            _limit()
        elif (torch := _torch()) is not None:
            torch.set(1)


def _limit() -> None:
    pools = _pools()
    _common.limit([pool for pool in pools if not pool.of_thread])
    _own.scope.limit([pool for pool in pools if pool.of_thread])


def _pools() -> list[Pool]:
    """The pools of this process; searched again if modules were loaded since."""
    global _modules, _found
    if len(sys.modules) != _modules:
        _found = [*_of_libraries(), *filter(None, [_torch()])]
        _modules = len(sys.modules)
    return _found


def _torch() -> Pool | None:
    torch = sys.modules.get("torch")
    if torch is None or not hasattr(torch, "set_num_threads"):  # it is being imported
        return None
    return Pool("torch", torch.get_num_threads, torch.set_num_threads, True)


def _of_libraries() -> list[Pool]:
    try:
        import ctypes

        files = {f"/{line.partition('/')[2]}" for line in _MAPS.read_text().splitlines()}
    except (ImportError, OSError):  # a Python without ctypes; not Linux
        return []
    pools = []
    for path in sorted(filter(_LIBRARY.search, files)):
        try:
            library = ctypes.CDLL(path, mode=os.RTLD_NOLOAD | os.RTLD_LAZY)
        except OSError:  # it was deleted
            continue
        for read, write, of_thread in _FUNCTIONS:
            if hasattr(library, read) and hasattr(library, write):
                pools.append(Pool(f"{path} {write}", getattr(library, read), getattr(library, write), of_thread))
    return pools
