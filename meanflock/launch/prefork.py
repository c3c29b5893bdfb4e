"""Fork the agents of `--count` from one process, and replace those that die."""

import contextlib
from logging import ERROR, WARNING

from meanflock.launch import forks
from meanflock.launch.forks import Forks
from meanflock.net.process import Interrupted, Restarts, how_it_ended, launched, orphaned
from meanflock.swarm import logs, plugins
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED, BadInput


def fork(count: int) -> int:
    """Fork `count` processes; returns in each of them, with its number.

    The parent never returns. It replaces a process that dies, ends when all have ended, and ends them all on a signal
    or when its launcher is gone. If the parent is killed, they end too.

    Raises:
        SystemExit: all have ended. 0: they finished, or were ended. 1: every one of them died again and again. 2: one
            of them ended with bad input, which all others have too.
    """
    if count == 1:
        return 0
    _preload()
    interrupted = Interrupted()
    restarts = Restarts()
    processes = Forks()
    due = list(range(count))
    while due or processes.living:
        for number in due:
            restarts.started(number)
            if processes.fork(number):
                forks.batch()
                return number
        due = _ended(processes, restarts)
        if interrupted or orphaned():
            processes.end_all()
            break
        if not due and processes.living:
            processes.wait(None, [0] if launched() else [])
    raise SystemExit(EXIT_DONE)


def _preload() -> None:
    """Load the entry points, and the built-in controllers, filters, topologies, codings and aggregation rules.

    Foreign plug-ins are loaded only by an agent that flies one, because their import may start threads.
    """
    for plugin in plugins.installed():
        if plugin.kind not in ("channel", "vehicle") and plugin.reference.startswith("meanflock."):
            with contextlib.suppress(BadInput):  # the agent that flies it reports the error
                plugins.load(plugin.kind, plugin.name)


def _ended(processes: Forks, restarts: Restarts) -> list[int]:
    """The numbers of the processes that have ended and are to be forked again."""
    due = []
    for number, code in processes.ended():
        if code == EXIT_BAD_INPUT:
            processes.end_all()
            raise SystemExit(EXIT_BAD_INPUT)
        if not code:
            continue
        if restarts.again(number):
            logs.note(f"agent process {number} {how_it_ended(code)}; another takes its place", WARNING)
            due.append(number)
            continue
        logs.show(f"error: agent process {number} {how_it_ended(code)}, too often: it is not started again", ERROR)
        if not processes.living and not due:
            raise SystemExit(EXIT_RUN_FAILED)
    return due
