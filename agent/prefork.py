"""Fork agents from one process that has loaded what all of them need, and wait for them.

Memory that no agent writes to exists once, and modules are imported once. Each agent is a full process, with its own
UAVs and session. The parent forks before it opens a session, because a fork does not copy threads.

Agents run under SCHED_BATCH: a message that wakes an agent does not preempt the process that computes. So there are
fewer context switches, and the world can send all requests at once.
"""

import contextlib
import gc
import os
import signal
import sys
import time
from logging import ERROR, WARNING

from meanflock.swarm import logs, plugins
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED, BadInput
from meanflock.swarm.process import CHILD, Interrupted, Restarts, how_it_ended, orphaned

SAFE = sys.platform == "linux"  # elsewhere system libraries may not survive a fork
_POLL_S = 0.05
_GRACE_S = 3.0  # a launcher waits a little longer


def fork(count: int) -> int:
    """Fork `count` processes; returns in each of them, with its number.

    The parent never returns. It replaces a process that dies, ends when all have ended, and ends them all on a signal
    or when its launcher is gone. If the parent is killed, the processes continue while the launcher lives.
    """
    if count == 1:
        return 0
    pipe = None if os.environ.get(CHILD) == "1" else os.pipe()  # the children read its end when the parent dies
    _preload()
    gc.collect()
    gc.freeze()  # so that the collector does not write to shared memory
    interrupted = Interrupted()  # a child installs its own; until then it ignores signals
    restarts = Restarts()
    living: dict[int, int] = {}
    due = list(range(count))
    while due:
        for number in due:
            restarts.started(number)
            pid = os.fork()
            if pid == 0:
                _become_a_process(pipe)
                return number
            living[pid] = number
        due = _await_deaths(living, restarts, interrupted)
    raise SystemExit(EXIT_DONE)


def _preload() -> None:
    """Load the entry points, and the built-in controllers, filters and topologies.

    Foreign plug-ins are loaded only by an agent that flies one, because their import may start threads.
    """
    for plugin in plugins.installed():
        if plugin.kind in ("controller", "filter", "topology") and plugin.reference.startswith("meanflock."):
            with contextlib.suppress(BadInput):  # the agent that flies it reports the error
                plugins.load(plugin.kind, plugin.name)


def _become_a_process(pipe: tuple[int, int] | None) -> None:
    if pipe is not None:
        listening, hold = pipe
        os.close(hold)
        os.dup2(listening, 0)  # `orphaned` waits for its end
        os.environ[CHILD] = "1"
    with contextlib.suppress(AttributeError, OSError):  # no Linux, or forbidden
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def _await_deaths(living: dict[int, int], restarts: Restarts, interrupted: Interrupted) -> list[int]:
    """Wait for the processes `living`, by process id; returns the numbers of those to fork again.

    Raises:
        SystemExit: all have ended. 0: they finished, or were ended. 1: every one of them died again and again. 2: one
            of them ended with bad input, which all others have too.
    """
    while living:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid:
            number, ended = living.pop(pid), os.waitstatus_to_exitcode(status)
            if ended == EXIT_BAD_INPUT:
                _end(living)
                raise SystemExit(EXIT_BAD_INPUT)
            if not ended:
                continue
            if restarts.again(number):
                logs.tell(f"warning: agent process {number} {how_it_ended(ended)}; another takes its place", WARNING)
                return [number]
            logs.tell(f"error: agent process {number} {how_it_ended(ended)}, too often: it is not started again", ERROR)
            if not living:
                raise SystemExit(EXIT_RUN_FAILED)
        elif interrupted or orphaned():
            _end(living)
        else:
            time.sleep(_POLL_S)
    raise SystemExit(EXIT_DONE)


def _end(living: dict[int, int]) -> None:
    """End all processes: SIGTERM, then SIGKILL. Not `process.end_all`, which takes processes of `subprocess`."""
    asked = time.monotonic()
    _signal(living, signal.SIGTERM)
    _signal(living, signal.SIGCONT)  # a stopped process handles no signal
    while living:
        pid, _ = os.waitpid(-1, os.WNOHANG)
        if pid:
            living.pop(pid)
            continue
        if time.monotonic() - asked > _GRACE_S:
            _signal(living, signal.SIGKILL)
        time.sleep(_POLL_S)


def _signal(living: dict[int, int], number: int) -> None:
    for pid in living:  # none has been reaped, so the ids are still theirs
        os.kill(pid, number)
