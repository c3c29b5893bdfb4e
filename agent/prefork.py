"""Agents that share what they loaded: one process loads it, forks as many as are wanted, and waits for them.

What none of them writes to is in memory once, and is imported once. They are processes like all others: each has its
UAVs, its session and its end. Forked before there is a session, for the threads of one would not come along.

They share their cores with each other and with the world, for which all of them wait, so none of them takes a core from
whoever computes as soon as a message wakes it: fewer changes of hands, and the world gets to ask everyone in one go.
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
    """Becomes `count` processes and returns in each, with its number. The one that was there waits for them and never
    returns: it forks another in the place of one that dies, ends when all have, and ends them when it is told to or
    when its launcher is gone. If it is killed they go on, as long as there is a launcher: its end they would notice.
    """
    if count == 1:
        return 0
    pipe = None if os.environ.get(CHILD) == "1" else os.pipe()  # its writing end is ours: they notice our end
    _load_what_each_would()
    gc.collect()
    gc.freeze()  # or the collector writes to all that is shared
    interrupted = Interrupted()  # a sibling will have its own; until it has, it hears nothing and is killed in the end
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


def _load_what_each_would() -> None:
    """Loads the entry points, and our own controllers, filters and topologies. Plug-ins of others are loaded only by an
    agent that flies one: nobody knows what their import starts.
    """
    for plugin in plugins.installed():
        if plugin.kind in ("controller", "filter", "topology") and plugin.reference.startswith("meanflock."):
            with contextlib.suppress(BadInput):  # for who is told to fly it to say
                plugins.load(plugin.kind, plugin.name)


def _become_a_process(pipe: tuple[int, int] | None) -> None:
    if pipe is not None:
        listening, hold = pipe
        os.close(hold)
        os.dup2(listening, 0)  # its end is what `orphaned` waits for
        os.environ[CHILD] = "1"
    with contextlib.suppress(AttributeError, OSError):  # no Linux, or forbidden
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def _await_deaths(living: dict[int, int], restarts: Restarts, interrupted: Interrupted) -> list[int]:
    """Waits for the processes `living`, by process id; the numbers of those that are to be forked again.

    Raises:
        SystemExit: all have ended: 0 if they went home or were told to end, 1 if every last one died again and again,
            2 if one was given what no other could use either.
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
            logs.tell(f"error: agent process {number} {how_it_ended(ended)}, as often before: it stays away", ERROR)
            if not living:
                raise SystemExit(EXIT_RUN_FAILED)
        elif interrupted or orphaned():
            _end(living)
        else:
            time.sleep(_POLL_S)
    raise SystemExit(EXIT_DONE)


def _end(living: dict[int, int]) -> None:
    """Ends all processes: first asked, then killed."""
    asked = time.monotonic()
    _signal(living, signal.SIGTERM)
    _signal(living, signal.SIGCONT)  # one that is frozen hears nothing
    while living:
        pid, _ = os.waitpid(-1, os.WNOHANG)
        if pid:
            living.pop(pid)
            continue
        if time.monotonic() - asked > _GRACE_S:
            _signal(living, signal.SIGKILL)
        time.sleep(_POLL_S)


def _signal(living: dict[int, int], number: int) -> None:
    for pid in living:  # none has been waited for: the ids are theirs
        os.kill(pid, number)
