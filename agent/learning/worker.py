"""Thread in which learners train, one after the other, while the UAVs fly on."""

import ctypes
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

from meanflock.swarm.errors import FAILURES

FIT_S = 300.0  # wall time after which a training is ended
_JOIN_S = 1.0
_NAME = "meanflock-learner"
_FORKS = ("os.fork", "os.forkpty")
_PROGRAMS = ("os.posix_spawn", "subprocess.Popen", "os.system")
_NO_PROCESS = "a learner may start no process; train in this one, for example with num_workers=0"


class Owner:
    """For whom jobs are done.

    Attributes:
        runs_programs: whether they may run other programs. starts_processes: whether a thread that one of them started
            has tried to start a process that they may not.
    """

    def __init__(self, *, runs_programs: bool) -> None:
        self.runs_programs = runs_programs
        self.starts_processes = False


class Job:
    """A call that the worker makes. Read `result` when `done` is set."""

    def __init__(self, call: Callable[[], Any], owner: Owner) -> None:
        self.call, self.owner = call, owner
        self.done = threading.Event()
        self.begun: float | None = None  # on the monotonic clock
        self._answer: Any = None
        self._error: BaseException | None = None

    def run(self) -> None:
        """Make the call, and keep its result or its error."""
        self.begun = time.monotonic()
        try:
            answer = self.call()
        except FAILURES as error:
            self.end(None, error)
        else:
            self.end(answer)

    def end(self, answer: Any, error: BaseException | None = None) -> None:
        """Set the result, unless there is one."""
        if not self.done.is_set():
            self._answer, self._error = answer, error
            self.done.set()

    def result(self) -> Any:
        """The result of the call, or its error raised; a RuntimeError if its owner has tried to start a process."""
        if self.owner.starts_processes:
            raise RuntimeError(_NO_PROCESS)
        if self._error is not None:
            raise self._error
        return self._answer


class TrainingThread:
    """Queue of jobs and the thread that does them; the thread ends when the queue is empty."""

    def __init__(self) -> None:
        self._queue: deque[Job] = deque()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._running: Job | None = None

    @property
    def is_idle(self) -> bool:
        """Returns whether no job runs or waits."""
        return self._thread is None

    def submit(self, call: Callable[[], Any], owner: Owner) -> Job:
        """Add a call to the queue."""
        job = Job(call, owner)
        with self._lock:
            self._queue.append(job)
            if self._thread is None:
                self._start()
        return job

    def call(self, call: Callable[[], Any], owner: Owner) -> Any:
        """Make a call in the thread, and wait for its result and, if nothing else is to do, for the thread's end."""
        job = self.submit(call, owner)
        thread = self._thread
        try:
            return self.wait(job)
        finally:
            if thread is not None and not self._queue:
                thread.join(_JOIN_S)  # so that this process may be forked

    def wait(self, job: Job) -> Any:
        """The result of a job. A job that runs longer than `FIT_S` is ended.

        Raises:
            TimeoutError: the job was ended. Or the error of the job.
        """
        while not job.done.wait(min(1.0, FIT_S)):
            running = self._running
            if running is not None and running.begun is not None and time.monotonic() - running.begun > FIT_S:
                self._abandon(running)
        return job.result()

    def _start(self) -> None:
        self._thread = threading.Thread(target=self._work, name=_NAME, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        _watch_learners()
        while True:
            with self._lock:
                if self._thread is not threading.current_thread():  # abandoned
                    return
                if not self._queue:
                    self._thread = self._running = None
                    return
                job = self._running = self._queue.popleft()
            _owners[threading.current_thread()] = job.owner
            job.run()

    def _abandon(self, job: Job) -> None:
        """Fail a job that hangs, stop its thread where Python can, and let another thread do the rest."""
        with self._lock:
            if self._running is not job or job.done.is_set() or self._thread is None:
                return
            job.end(
                None, TimeoutError(f"it has trained for {FIT_S:g} s of wall time, the most that a training may take")
            )
            ident = self._thread.ident or 0
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(ident), ctypes.py_object(SystemExit))
            self._running = None
            self._start()


TRAININGS = TrainingThread()  # of this process; random generators are global, so there is one


_is_watched = False
_owners: WeakKeyDictionary[threading.Thread, Owner] = WeakKeyDictionary()  # of the worker and the threads of learners


def started_threads() -> int:
    """Number of running threads that the owner of the job of this thread has started."""
    owner = _owners.get(me := threading.current_thread())
    return sum(_owners.get(thread) is owner for thread in threading.enumerate() if thread is not me)


def _watch_learners() -> None:
    """Make starting a process an error in threads of learners; a fork would copy the connection of the agent."""
    global _is_watched
    if not _is_watched:
        _is_watched = True
        sys.addaudithook(_refuse_event)
        _refuse_multiprocessing()
        _note_threads()


def _note_threads() -> None:
    """Note the threads that a learner starts; Python 3.11 has no other way to know who started a thread."""
    start = threading.Thread.start

    def noted(thread: threading.Thread) -> None:
        if (owner := _owners.get(threading.current_thread())) is not None:
            _owners[thread] = owner
        start(thread)

    threading.Thread.start = noted  # type: ignore[method-assign, assignment]


def _refuse_event(event: str, _arguments: Any) -> None:
    owner = _owners.get(threading.current_thread())
    if event in _FORKS or (event in _PROGRAMS and owner is not None and not owner.runs_programs):
        _refuse()


def _refuse_multiprocessing() -> None:
    """Its processes that are spawned, or forked by a server, cause no event."""
    from multiprocessing.process import BaseProcess  # here: an agent without learner does not need it

    start = BaseProcess.start

    def refused(process: BaseProcess) -> None:
        _refuse()
        start(process)

    BaseProcess.start = refused  # type: ignore[method-assign, assignment]


def _refuse() -> None:
    """Nobody sees the error in a thread of the learner's own, so the training fails, too."""
    if (owner := _owners.get(thread := threading.current_thread())) is not None:
        owner.starts_processes |= thread.name != _NAME
        raise RuntimeError(_NO_PROCESS)
