"""Threads of this process that compute parts of a large swarm side by side."""

import multiprocessing
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from meanflock.swarm.threads import limited

Part = TypeVar("Part")
Result = TypeVar("Result")

_pool: ThreadPoolExecutor | None = None


def cores(groups: Path = Path("/sys/fs/cgroup")) -> int:
    """Cores that this process may use: those it is bound to, or fewer by the limit of a container."""
    bound = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = (groups / "cpu.max").read_text().split()
        return max(1, min(bound, -(-int(quota) // int(period))))
    except (OSError, ValueError):  # no limit, or no control groups of this version
        return bound


def free_cores() -> int:
    """Cores that a flight of this process may use: one if the process is one of several that share the cores."""
    return 1 if multiprocessing.parent_process() is not None else cores()


def each(call: Callable[[Part], Result], parts: Iterable[Part]) -> list[Result]:
    """The results of calls with each part, in their order. The calls run side by side, each with one thread of the
    numeric libraries."""
    global _pool
    if _pool is None:
        _pool = ThreadPoolExecutor(cores(), "rows")
    return list(_pool.map(limited()(call), parts))


def _forget() -> None:
    """A forked process has none of the threads."""
    global _pool
    _pool = None


os.register_at_fork(after_in_child=_forget)
