"""A node's side of the protocol, the same for agents and leader: join, answer every Sense with an Act, leave."""

import logging
import os
import platform
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Protocol

import msgspec
import numpy as np

from meanflock.net import keys, tick
from meanflock.net.bus import Bus, Delivery
from meanflock.swarm import plugins, threads
from meanflock.swarm.errors import (
    BadInput,
    BusError,
    MeanflockError,
    MessageRejected,
    Refused,
    RunFailed,
    WorldGone,
    last_line,
)
from meanflock.swarm.events.nodes import FailedAverage, FailedController, FailedTraining, FoundDraw, Problem
from meanflock.swarm.global_generators import DrawWatch
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import (
    DREW,
    FAILED,
    UNAVERAGED,
    UNTRAINED,
    Act,
    Event,
    Join,
    Message,
    Ready,
    Refusal,
    Sense,
    Stop,
    Welcome,
)

log = logging.getLogger("meanflock.node")

_READY_AGAIN_S = 0.2  # Ready is repeated until the first Sense, because a message after a declaration can get lost
_ASK_TIMEOUT_S = 2.0
# The loss of a predecessor is noticed within milliseconds if it was killed, at the barrier if it was stopped.
_REFUSED_AGAIN_S = 0.25
_MAX_DROP_LINES = 100  # in the log; the counter counts all
_ATTEMPT_S = 0.5  # first attempt to connect, each further one twice as long; a signal waits until it is over
_LONGEST_ATTEMPT_S = 4.0
_MOST_RETURNS = 3  # rejoins of a node that was stopped; each costs all others the time of a barrier


class Node(Protocol):
    """Agent or leader."""

    @property
    def problems(self) -> list[Problem]:
        """Problems to report to the world; the client reports and clears them."""

    def act(self, sense: Sense) -> Act:
        """Reply to a Sense; MessageRejected leaves the node unchanged."""


class _NodeFailed(Exception):
    """The node raised `error`, in this tick or in one before, and cannot go on."""

    def __init__(self, error: BaseException) -> None:
        super().__init__(last_line(error))
        self.error = error


class NodeClient:
    """Connection of a node to the world, over a bus."""

    def __init__(self, bus: Bus, run: str) -> None:
        self._bus, self._run = bus, run
        self._fingerprint = keys.fingerprint(run)
        self._node: Node  # set when the world has admitted it
        self._last_tick = -1
        self._last_act = b""
        # One thread at a time calls the node; on a memory bus the same thread may call again.
        self._busy = threading.RLock()
        self._failure: BaseException | None = None  # of the node, in any thread
        self.stopped: Stop | None = None  # the world's last message
        self._gone = False  # whether the world vanished without a Stop
        self.dropped: Counter[str] = Counter()

    def join(
        self,
        request: Join,
        make: Callable[[Welcome], Node],
        timeout_s: float,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Welcome:
        """Ask until a world admits the node, make the node, and listen. `cancelled` is called between two questions.

        A node whose predecessor is not yet known to be lost is refused for now, and asks again.

        Raises:
            Refused: the world did not admit the node.
            BusError: no world answered in time.
        """
        request = msgspec.structs.replace(request, token=int.from_bytes(os.urandom(7), "little"))
        welcome = self._ask(request, timeout_s, cancelled)
        if not isinstance(welcome, Welcome) or welcome.run != self._fingerprint:
            raise BusError(f"the world of run {self._run!r} answered with {type(welcome).__name__}")
        self._act_key = keys.act(self._run, welcome.node)
        self._blank = np.zeros((len(welcome.uavs), welcome.initial_states.shape[-1]))  # of the states of a Sense
        self._nodes = len(welcome.initial_states) + welcome.stations
        try:
            _check_plugins(welcome, request.role)
            self._draws = DrawWatch()
            self._node = make(welcome)
            threads.renew()
        except BadInput as error:  # the world logs it too, so that its user sees it
            reason = f"{welcome.node} on host {platform.node()}: {error}"
            self._bus.put(self._act_key, control.encode(Refusal(reason)))
            raise BadInput(reason) from error
        self._bus.subscribe(keys.sense(self._run, welcome.node), self._at_once)
        self._bus.watch(keys.alive(self._run, "world", "world"))
        self._bus.announce(keys.alive(self._run, request.role, welcome.node))
        self._ready()
        return welcome

    def serve(self, cancelled: Callable[[], bool], abandoned: Callable[[], bool]) -> str:
        """Serve until the world sends Stop (`stopped`) or the process should end; returns the reason.

        `cancelled` is called after every delivery, `abandoned` only without a delivery.

        Raises:
            WorldGone: the session with the world ended without a Stop.
        """
        while self.stopped is None:
            if self._gone:
                raise WorldGone(f"the world of run {self._run!r} is gone; `meanflock resume` continues its run")
            if cancelled():
                return "interrupted"
            delivery = self._bus.receive(_READY_AGAIN_S)
            if delivery is not None:
                self.handle(delivery)
            elif abandoned():
                return "the launcher is gone"
            elif self._last_tick < 0:
                self._ready()
        return self.stopped.reason

    def handle(self, delivery: Delivery) -> None:
        """Handle one delivery. An invalid message is dropped, counted and logged, and changes nothing.

        Raises:
            BadInput: a plug-in failed that all nodes need, and would fail in others too.
            BaseException: the node failed otherwise. Of each failure the world gets the reason.
        """
        if delivery.kind == "gone":
            self._gone = True
        elif delivery.kind == "message":
            with self._busy:
                take = self._asked if delivery.payload[1:2] in tick.TYPES else self._control
                try:
                    take(delivery.key, delivery.payload)
                except _NodeFailed as failed:
                    has_text = isinstance(failed.error, MeanflockError)
                    self._node.problems.append(str(failed.error if has_text else failed))
                    self._report_problems()
                    if isinstance(failed.error, RunFailed):
                        raise BadInput(str(failed.error)) from failed
                    raise failed.error from None

    def _asked(self, key: str, raw: bytes) -> None:
        """Reply to one message of a tick, while no other thread calls the node."""
        try:
            sense = tick.read_sense(raw, self._blank.copy(), self._nodes)
            if sense.run != self._fingerprint:
                raise MessageRejected("wrong-run", f"run {sense.run:#x}, this is {self._fingerprint:#x}")
            if sense.tick < self._last_tick:
                raise MessageRejected("stale", f"tick {sense.tick} after {self._last_tick}")
            if sense.tick > self._last_tick:
                self._last_act = tick.write_act(self._computed(sense))
                self._last_tick = sense.tick
                if self._draws.finds_a_draw(sense.tick):
                    self._node.problems.append(FoundDraw())
                if self._node.problems:
                    self._report_problems()
            # A world that repeats a tick has not received the reply. It gets the same one; the node does not act twice.
            self._bus.put(self._act_key, self._last_act)
        except MessageRejected as error:
            self._drop(key, error)

    def _computed(self, sense: Sense) -> Act:
        """The reply of the node. After a failure it computes nothing, because a part of the tick may be done."""
        if self._failure is None:
            try:
                return self._node.act(sense)
            except MessageRejected:
                raise
            except BaseException as error:  # as plug-ins may raise
                self._failure = error
        raise _NodeFailed(self._failure)

    def _drop(self, key: str, error: MessageRejected) -> None:
        self.dropped[error.reason] += 1
        if self.dropped.total() <= _MAX_DROP_LINES:
            about = {"tick": self._last_tick, "reason": error.reason}
            log.warning("dropped a message under %s: %s", key, error, extra=about)

    def _ask(self, request: Join, timeout_s: float, cancelled: Callable[[], bool]) -> Message:
        """The first answer of a world that is not a temporary refusal."""
        question, raw = keys.join(self._run, keys.requested_name(request.role, request.uav)), control.encode(request)
        failure = BusError(f"no world of run {self._run!r} answered within {timeout_s:.0f} s")
        end = time.monotonic() + timeout_s
        while True:
            if (answer := self._bus.ask(question, raw, _ASK_TIMEOUT_S)) is not None:
                message = control.decode(answer)
                if not isinstance(message, Refusal):
                    return message
                failure = Refused(f"the world refused: {message.reason}", message.over)
                if not message.for_now:
                    raise failure
                log.info("refused for now: %s", message.reason)
            if cancelled():
                raise BusError(f"interrupted while asking to take part: {failure}")
            if (left := end - time.monotonic()) <= 0:
                raise failure
            if answer is not None:
                time.sleep(min(_REFUSED_AGAIN_S, left))

    def _at_once(self, key: str, raw: bytes) -> bool:
        """Reply to a Sense in the thread that brings it, unless the node is busy; a switch of threads costs as much as
        the reply. Returns whether it replied; if not, `handle` gets the message.
        """
        if raw[1:2] not in tick.TYPES or not self._busy.acquire(False):
            return False
        try:
            self._asked(key, raw)
            return True
        except _NodeFailed:  # `handle` gets the message, and fails in the thread that ends the process
            return False
        finally:
            self._busy.release()

    def _control(self, key: str, raw: bytes) -> None:
        """Read a control message, which must be Stop."""
        try:
            self.stopped = control.decode_as(Stop, raw, self._fingerprint)
        except MessageRejected as error:
            self._drop(key, error)

    def _report_problems(self) -> None:
        for problem in self._node.problems:
            match problem:
                case FailedTraining():
                    event = Event(self._last_tick, UNTRAINED, problem.failure, (problem.uav,))
                case FailedAverage():
                    event = Event(self._last_tick, UNAVERAGED, problem.failure, problem.uavs)
                case FoundDraw():
                    event = Event(self._last_tick, DREW, "")
                case FailedController():
                    event = Event(self._last_tick, FAILED, problem.failure, problem.uavs)
                case _:
                    event = Event(self._last_tick, FAILED, problem)
            self._bus.put(self._act_key, control.encode(event))
        self._node.problems.clear()

    def _ready(self) -> None:
        self._bus.put(self._act_key, control.encode(Ready(self._fingerprint)))


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
    """Connect, join and serve until the world sends Stop; returns the world's reason.

    If its session is lost (its connection was reset, or cut for longer than the lease), the world has counted the node
    as lost. The node opens a new session and joins again as a new node; if the flight is over by then, it leaves. A
    node that was stopped by a signal and then learns that it is lost also joins again, but only a few times, and not if
    another node has its place.

    Args:
        connect: opens a session within this many seconds, or raises BusError.
        wait_s: how long to wait for a world, at the start and after each loss of the session.
        cancelled: called after every delivery and between two attempts.
        abandoned: the same, but not while the node has work.
        welcomed: called after every admission.

    Raises:
        WorldGone: the session was lost, and no world could be reached in time.
        BusError: no world answered in time at first, or it refused the node.
    """
    lost: WorldGone | None = None
    missed: str | None = None  # reason of the world's last Stop, if it declared this node lost
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
            if client.stopped is None or not client.stopped.lost or times > _MOST_RETURNS:
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
    """Open a session before the time `end` of the monotonic clock; `over` is called between two attempts.

    Raises:
        BusError: no session in time, or `over`.
    """
    attempt_s = _ATTEMPT_S
    while True:
        left = end - time.monotonic()
        try:
            return connect(max(0.0, min(attempt_s, left)))
        except BusError:
            if left <= attempt_s or over():
                raise
        attempt_s = min(2.0 * attempt_s, _LONGEST_ATTEMPT_S)


def _check_plugins(welcome: Welcome, role: str) -> None:
    """Check that this host has the plug-ins that a node needs, in the world's versions: controller, learner,
    filter, leader's rule.

    Raises:
        BadInput: one is missing, or has another version here.
    """
    for kind, name, fingerprint in welcome.plugins:
        if kind in ("controller", "learner", "filter") or (kind == "aggregator" and role == "leader"):
            here = plugins.find(kind, name)
            if here.fingerprint != fingerprint:
                raise BadInput(f"{kind} {name!r} is of {here.fingerprint} here, and of {fingerprint} with the world")
