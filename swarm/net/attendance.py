"""How the process of a node takes part in a run: it connects, joins, serves, and again if its session is lost."""

import logging
import time
from collections.abc import Callable

from meanflock.swarm.errors import BusError, Refused, WorldGone
from meanflock.swarm.net.bus import Bus
from meanflock.swarm.net.client import Node, NodeClient
from meanflock.swarm.wire.messages import Join, Welcome

log = logging.getLogger("meanflock.node")

_STEP_S, _STEP_AT_MOST_S = 0.5, 4.0  # of an attempt to connect, each twice the last; no signal is dealt with in one
_MISSED_AT_MOST = 3  # times: a node that is always too slow costs all others a barrier each time


def take_part(
    connect: Callable[[float], Bus],
    run: str,
    request: Join,
    make: Callable[[Welcome], Node],
    wait_s: float,
    cancelled: Callable[[], bool],
    abandoned: Callable[[], bool],
    welcomed: Callable[[Welcome], None] = lambda welcome: None,
) -> str:
    """Serves until the world says stop, and returns why.

    A node whose session is lost (its connection was reset, or cut for longer than the lease) has been missed by the
    world: it opens another one and joins again, as a new node; if the flight is over by then, it goes home. One that
    was frozen and is told that it is taken for lost joins again too, but only a few times, and not if another has its
    place by then.

    Args:
        connect: opens a session within so many seconds, or raises BusError.
        wait_s: for a world, at first and whenever the session is lost.
        cancelled: asked after every delivery and between two attempts; `abandoned`: likewise, but not while the node
            has something to do.
        welcomed: told of every admission.

    Raises:
        WorldGone: the session was lost, and no world could be reached in time.
        BusError: no world answered in time at first, or it refused.
    """
    lost: WorldGone | None = None
    missed: str | None = None  # why the world takes this node for lost, if it has said so last
    times = 0

    def over() -> bool:
        return cancelled() or abandoned()

    while True:
        end = time.monotonic() + wait_s
        try:
            bus = connected(connect, end, over)
            try:
                client = NodeClient(bus, run)
                patience_s = 0.0 if missed else max(0.0, end - time.monotonic())
                welcomed(client.join(request, make, patience_s, over))
                lost = None
                missed = client.serve(cancelled, abandoned)
            finally:
                bus.close()
            times += 1
            if client.stopped is None or not client.stopped.lost or times > _MISSED_AT_MOST:
                return missed
        except WorldGone as error:
            lost, missed = error, None
            log.warning("lost the session with the world; trying to come back for %.0f s", wait_s)
        except BusError as error:
            if missed is not None:
                return missed
            if lost is not None and isinstance(error, Refused) and error.over:
                return str(error)
            if over() and not isinstance(error, Refused):
                return "interrupted"
            if lost is None or isinstance(error, Refused):
                raise
            raise lost from error


def connected(connect: Callable[[float], Bus], end: float, over: Callable[[], bool]) -> Bus:
    """A session, opened before `end` by the monotonic clock; whether it is `over` is asked between two attempts.

    Raises:
        BusError: not in time, or it is over.
    """
    step_s = _STEP_S
    while True:
        left = end - time.monotonic()
        try:
            return connect(max(0.0, min(step_s, left)))
        except BusError:
            if left <= step_s or over():
                raise
        step_s = min(2.0 * step_s, _STEP_AT_MOST_S)
