"""The flight runner of all studies: flies in this process, in processes of this machine, or on a Dask cluster."""

import importlib
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import islice
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from queue import SimpleQueue
from types import FrameType, ModuleType
from typing import Any, TypeVar

from meanflock.swarm import plugins
from meanflock.swarm.errors import EXIT_RUN_FAILED, BadInput, MeanflockError, RunFailed
from meanflock.swarm.workers import cores

BACKENDS = ("processes", "dask")
SCHEDULER_TIMEOUT = "10s"
_ATTEMPTS = 2
_HANDED_TO_CLUSTER = 1000  # tasks that a cluster may have at once
_POLL_S = 0.5

Jobs = int | Executor  # a number of processes, -1 for one a core; or the executor of a cluster
Task = TypeVar("Task")
Result = TypeVar("Result")


class WorkerDied(RunFailed):
    """A process died twice while it flew one of `tasks`."""

    def __init__(self, tasks: Sequence[Any]) -> None:
        super().__init__("a process died twice, perhaps for want of memory")
        self.tasks = tasks


def run(
    function: Callable[[Task], Result], tasks: Iterable[Task], jobs: Jobs, finished: Callable[[Task, Result], None]
) -> None:
    """Calls `function` of every task, and in this process `finished` of each task and its result, as results come.

    A task whose process died is tried once more. The processes end with this call. A process that cannot have children,
    such as a worker of a pool, flies everything itself.

    Args:
        function: a function of a module, which other processes import. With one job, any function.

    Raises:
        WorkerDied: a process died twice.
        RunFailed: the cluster failed.
    """
    call = partial(_with_plugins, function, plugins.files())
    waiting = dict(enumerate(tasks))
    if isinstance(jobs, Executor):
        try:
            _fly(jobs, call, waiting, _HANDED_TO_CLUSTER, finished, {})
        except MeanflockError:
            raise
        except Exception as error:  # the exceptions of a scheduler or worker that is gone have no common class
            raise RunFailed(f"dask: {error!r}; what is finished is kept, repeat the command to go on") from error
    elif (count := min(_number_of(jobs), len(waiting))) > 1:
        _fly_in_processes(count, call, waiting, finished)
    else:
        for task in waiting.values():
            finished(task, function(task))


def _with_plugins(function: Callable[[Task], Result], files: Sequence[tuple[str, str]], task: Task) -> Result:
    """Registers the plug-ins of the process that started this one, then calls the function."""
    plugins.hold(files)
    return function(task)


def _number_of(jobs: int) -> int:
    """Number of processes; negative numbers count down from one a core."""
    current = multiprocessing.current_process()
    if current.daemon or isinstance(current, _Worker):
        return 1
    return jobs if jobs > 0 else max(1, cores() + 1 + jobs)


def _fly(
    executor: Executor,
    call: Callable[[Task], Result],
    waiting: dict[int, Task],
    width: int,
    finished: Callable[[Task, Result], None],
    running: dict[Future[Result], int],
) -> None:
    """Submits the tasks, at most `width` at once. `waiting` and `running` always have the tasks without a result."""
    ended: SimpleQueue[Future[Result]] = SimpleQueue()
    numbers = iter(list(waiting))
    while waiting:
        with _signals_deferred():
            for number in islice(numbers, width - len(running)):
                future = executor.submit(call, waiting[number])
                running[future] = number
                future.add_done_callback(ended.put)
        future = ended.get()
        result = future.result()
        finished(waiting.pop(running.pop(future)), result)


# -- processes of this machine -----------------------------------------------------------------------------------------


def _fly_in_processes(
    count: int, call: Callable[[Task], Result], waiting: dict[int, Task], finished: Callable[[Task, Result], None]
) -> None:
    """Fly in a pool of processes; tasks of a pool that breaks are flown again in a new one.

    A pool does not tell in which task a process died, so all submitted tasks without a result are suspects.
    """
    deaths: Counter[int] = Counter()
    while waiting:
        running: dict[Future[Result], int] = {}
        try:
            with _pool(count) as executor:
                _fly(executor, call, waiting, 2 * count, finished, running)
        except BrokenProcessPool as error:
            deaths.update(running.values())
            guilty = [waiting[number] for number in running.values() if deaths[number] >= _ATTEMPTS]
            if guilty:
                raise WorkerDied(guilty) from error


@contextmanager
def _pool(count: int) -> Iterator[Executor]:
    """A pool whose processes are killed at the end of the block: they may be in the middle of a long flight."""
    context = _Context()
    executor = ProcessPoolExecutor(count, context, _become_a_worker, (os.getpid(),))
    try:
        yield executor
    finally:
        with _signals_deferred():
            for process in context.workers:
                process.kill()
            executor.shutdown()


class _Worker(SpawnProcess):
    """A process that does not import the main program: a script needs no `if __name__ == "__main__"`."""

    def start(self) -> None:
        """Starts it while the main module is an empty one."""
        main = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            super().start()
        finally:
            sys.modules["__main__"] = main


class _Context(SpawnContext):
    """The start method of a pool, which knows the processes that it started."""

    def __init__(self) -> None:
        self.workers: list[_Worker] = []

    def Process(self, *args: Any, **options: Any) -> _Worker:  # type: ignore[override]
        """A process of the pool."""
        worker = _Worker(*args, **options)
        self.workers.append(worker)
        return worker


def _become_a_worker(parent: int) -> None:
    """Ignore Ctrl-C, and end when the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_POLL_S)
    os._exit(EXIT_RUN_FAILED)


# -- clusters ----------------------------------------------------------------------------------------------------------


@contextmanager
def workers(backend: str, scheduler: str | None, jobs: int = -1) -> Iterator[Jobs]:
    """Context with the workers for `run`: `jobs` itself, or the executor of a Dask cluster.

    Args:
        scheduler: address of the Dask scheduler; None: a cluster of `jobs` processes on this machine.

    Raises:
        BadInput: an unknown backend, Dask is not installed, or there is no scheduler at that address.
    """
    if backend not in BACKENDS:
        raise BadInput(f"backend {backend!r}: there are {' and '.join(BACKENDS)}")
    if backend != "dask":
        if scheduler is not None:
            raise BadInput(f"--scheduler {scheduler}: is of dask; add --backend dask, or leave it out")
        yield jobs
        return
    try:
        client_class = importlib.import_module("distributed").Client
    except ImportError as error:
        raise BadInput("--backend dask: not installed; pip install 'meanflock[dask]'") from error
    try:
        if scheduler is None:
            client = client_class(n_workers=_number_of(jobs), threads_per_worker=1, dashboard_address=None)
        else:
            client = client_class(scheduler, timeout=SCHEDULER_TIMEOUT)
    except (OSError, ValueError) as error:
        raise BadInput(f"--scheduler {scheduler}: {error}") from error
    with client:
        executor: Executor = client.get_executor(pure=False)
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)  # cancels what was not flown


# -- signals -----------------------------------------------------------------------------------------------------------


@contextmanager
def terminable(out: Path) -> Iterator[None]:
    """Ctrl-C and SIGTERM end a study of the folder `out` and its processes, and the error says how to go on.

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
        data = out / "data"
        kept = f"; flights that were finished are kept in {data}: repeat the command to go on" if data.exists() else ""
        raise RunFailed(f"interrupted{kept}") from None
    finally:
        if in_main:
            signal.signal(signal.SIGTERM, before)


@contextmanager
def _signals_deferred() -> Iterator[None]:
    """Defers Ctrl-C and SIGTERM to the end of the block: a pool that is interrupted while it starts or ends may leave
    processes behind. Processes that start in the block never receive Ctrl-C.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _frame: received.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    resource_tracker.ensure_running()  # it unblocks signals when it starts, so it starts first
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # processes inherit a mask, but no handler
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            signal.signal(number, handler)
        if received:
            signal.raise_signal(received[0])
