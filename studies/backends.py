"""Where the flights of a study are flown: processes of this machine, or the workers of a Dask cluster."""

import importlib
import multiprocessing
import os
import signal
import threading
import time
import warnings
from collections.abc import Generator, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from types import FrameType
from typing import Any

from meanflock.swarm.errors import EXIT_RUN_FAILED, BadInput, RunFailed

BACKENDS = ("loky", "dask")
SCHEDULER_TIMEOUT = "10s"
_POLL_S = 0.5
_first: list[int] = []  # the process that asked for workers


def possible(jobs: int) -> int:
    """How many processes may fly what this one asks for, `jobs` as joblib has it: itself alone if it is a worker of
    `multiprocessing`, which may have none, or a fork of one that has some, whose answers it would never see.
    """
    if jobs == 1 or multiprocessing.current_process().daemon:
        return 1
    if not _first:
        _first.append(os.getpid())
    return jobs if _first == [os.getpid()] else 1


@contextmanager
def processes(backend: str, scheduler: str | None, workers: int | None = None) -> Iterator[None]:
    """What joblib's calls within this block use.

    Args:
        scheduler: of dask, its address; None: a cluster on this machine, for as long as the block lasts.
        workers: of such a cluster; None: one a core.

    Raises:
        BadInput: dask is not installed, or there is no scheduler at that address.
    """
    import joblib  # here: most commands fly nothing in parallel, and start without it

    if backend == "loky":
        with joblib.parallel_config(backend="loky"):
            yield
        return
    try:
        client_of = importlib.import_module("distributed").Client
    except ImportError as error:
        raise BadInput("--backend dask: not installed; pip install 'meanflock[dask]'") from error
    try:
        if scheduler is None:
            client = client_of(n_workers=workers, threads_per_worker=1, dashboard_address=None)
        else:
            client = client_of(scheduler, timeout=SCHEDULER_TIMEOUT)
    except (OSError, ValueError) as error:
        raise BadInput(f"--scheduler {scheduler}: {error}") from error
    with client, joblib.parallel_config(backend="dask"):
        yield


@contextmanager
def terminable(out: Path) -> Iterator[None]:
    """Ctrl-C and SIGTERM end a study of the folder `out`, workers and all, and say how to go on.

    Raises:
        RunFailed: it was ended.
    """

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    in_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, interrupt) if in_main else None
    try:
        yield
    except KeyboardInterrupt:
        raise RunFailed(
            f"interrupted; flights that were finished are kept in {out / 'data'}: repeat the command to go on"
        ) from None
    finally:
        if in_main:
            signal.signal(signal.SIGTERM, before)


def started(calls: Iterable[Any], jobs: int, **how: Any) -> Iterator[Any]:
    """Starts what `joblib.delayed` made, in `jobs` processes; the results, as they come unless `how` says otherwise.

    Of this machine, the processes leave Ctrl-C to this one and end with it, however it ends.
    """
    from joblib.parallel import LokyBackend, Parallel, get_active_backend

    from meanflock.studies.pool import Pool

    active, _ = get_active_backend()
    backend = Pool() if isinstance(active, LokyBackend) else None
    how = {"return_as": "generator_unordered", "batch_size": 1, "backend": backend, **how}
    parallel = Parallel(n_jobs=jobs, initializer=_become_a_worker, initargs=(os.getpid(),), **how)
    with ExitStack() as stack:
        with _unbroken():
            results = parallel(calls)
            stack.callback(_close, results)
        for result in results:  # noqa: UP028  # `yield from` would close it itself
            yield result


def _close(results: Generator[Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that some were not fetched: who stops early says what is kept
        results.close()


def _become_a_worker(parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it goes to the whole group; the parent decides
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_POLL_S)
    os._exit(EXIT_RUN_FAILED)


@contextmanager
def _unbroken() -> Iterator[None]:
    """Ctrl-C and SIGTERM take effect when the block is over: a pool of processes that is torn down while it starts
    raises errors of its own and may leave some behind. What is started meanwhile never hears of Ctrl-C.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _frame: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    resource_tracker.ensure_running()  # where it is started later, it unblocks them
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which a process inherits, and no handler
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
