"""Agents that share what they loaded: one process loads it, forks as many as are wanted, and waits for them.

What none of them writes to is in memory once, and is imported once. They are processes like all others: each has its
UAVs, its session and its end. Forked before there is a session, for the threads of one would not come along.

They share their cores with each other and with the world, for which all of them wait, so none of them takes a core from
whoever computes as soon as a message wakes it: fewer changes of hands, and the world gets to ask everyone in one go.
"""

import contextlib
import gc
import logging
import os
import signal
import sys
import time
from typing import NoReturn

from swarm import logs
from swarm.errors import EXIT_RUN_FAILED
from swarm.process import CHILD, Interrupted, orphaned

SAFE = sys.platform == "linux"  # elsewhere system libraries may not survive a fork
_POLL_S = 0.05
_GRACE_S = 3.0  # a launcher waits a little longer


def fork(count: int) -> int:
    """Becomes `count` processes and returns in each, with its number. The one that was there waits for them and never
    returns: it ends when they have, and ends them when it is told to, when its launcher is gone or when one fails.
    """
    if count == 1:
        return 0
    listening, hold = os.pipe()
    gc.collect()
    gc.freeze()  # or the collector writes to all that is shared
    interrupted = Interrupted()  # a sibling will have its own; until it has, it hears nothing and is killed in the end
    living: dict[int, int] = {}
    for number in range(count):
        pid = os.fork()
        if pid == 0:
            os.close(hold)
            os.dup2(listening, 0)  # its end is what `orphaned` waits for
            os.environ[CHILD] = "1"
            with contextlib.suppress(AttributeError, OSError):  # no Linux, or forbidden
                os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
            return number
        living[pid] = number
    os.close(listening)
    _wait(living, interrupted)


def _wait(living: dict[int, int], interrupted: Interrupted) -> NoReturn:
    code, asked = 0, 0.0
    while living:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid:
            number, ended = living.pop(pid), os.waitstatus_to_exitcode(status)
            if ended and not asked:
                how = f"was killed by {signal.Signals(-ended).name}" if ended < 0 else f"ended with exit code {ended}"
                logs.tell(f"error: agent process {number} {how}", logging.ERROR)
                code = max(ended, EXIT_RUN_FAILED)
            continue
        if not asked and (code or interrupted or orphaned()):
            asked = time.monotonic()
            _signal(living, signal.SIGTERM)
            _signal(living, signal.SIGCONT)  # one that is frozen hears nothing
        elif asked and time.monotonic() - asked > _GRACE_S:
            _signal(living, signal.SIGKILL)
        time.sleep(_POLL_S)
    raise SystemExit(code)


def _signal(living: dict[int, int], number: int) -> None:
    for pid in living:  # none has been waited for: the ids are theirs
        os.kill(pid, number)
