"""A Grid of Flower whose messages are the rounds of a federation.

The ServerApp runs in a thread of its own. Each time that it waits for replies of a training, a round flies.
"""

import logging
import math
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from flwr.app import Error, Message, MetricRecord, RecordDict
from flwr.common.constant import ErrorCode
from flwr.compat.common import recorddict_compat as compat
from flwr.server import server as classic
from flwr.serverapp import Grid
from flwr.serverapp.strategy import Result
from flwr.serverapp.strategy import strategy as modern
from flwr.supercore.run import Run
from numpy.typing import NDArray

from meanflock.agent.learning.worker import FIT_S
from meanflock.flower.app import FIRST_NODE, App, context, split
from meanflock.swarm.errors import FAILURES, last_line
from meanflock.swarm.global_generators import Generators

log = logging.getLogger("meanflock.flower")

LOST = 900  # code of the error of a reply that the radio lost
ASKED_TOO_OFTEN = 5  # times that a ServerApp asks for the nodes without sending anything
Answer = Callable[[Message], Message]


class Asked(NamedTuple):
    """What a ServerApp sends to some nodes: arrays by name, and all else of the message."""

    arrays: dict[str, NDArray[Any]]
    rest: bytes
    nodes: tuple[int, ...]


class _Probed(BaseException):
    """Unwinds a ServerApp at its first message."""


class RadioGrid(Grid):
    """A Grid of UAVs.

    Attributes:
        asked: what the ServerApp sent last. number: of that exchange, from 1.
        reports: results of its strategy, as Flower collects them.
    """

    def __init__(self, uavs: int, answer: Answer, exchange: Callable[[], None], expires: int = 1) -> None:
        """
        Args:
            answer: answers messages that are no training, which nobody flies.
            exchange: called by the ServerApp's thread when it waits; returns when a round is over.
            expires: exchanges after which a message without a reply has failed.
        """
        self.asked: Asked | None = None
        self.number = 0
        self.reports: list[Any] = []
        self._uavs, self._answer, self._exchange, self._expires = uavs, answer, exchange, expires
        self._queue: dict[int, Message] = {}  # by node, to be sent with the next exchange
        self._sent: dict[tuple[int, int], Message] = {}  # without a reply, by number of the exchange, and node
        self._replies: dict[str, Message] = {}  # by the number of the message
        self._messages = 0
        self._looks = 0  # for nodes, since anything was sent

    # -- Flower's side ----------------------------------------------------------------------------------------------

    def set_run(self, run: Run) -> None:
        """Flower's number of a run; there is one."""

    @property
    def run(self) -> Run:
        """The one run."""
        return Run.create_empty(1)

    def create_message(
        self, content: RecordDict, message_type: str, dst_node_id: int, group_id: str, ttl: float | None = None
    ) -> Message:
        """A message to a node."""
        return Message(content, dst_node_id, message_type, ttl=ttl, group_id=group_id)

    def get_node_ids(self) -> Iterable[int]:
        """The nodes: one on each UAV.

        Raises:
            ValueError: the ServerApp waits for more.
        """
        self._looks += 1
        if self._looks > ASKED_TOO_OFTEN:
            raise ValueError(_too_few(self._uavs))
        return [FIRST_NODE + uav for uav in range(self._uavs)]

    def push_messages(self, messages: Iterable[Message]) -> Iterable[str]:
        """Take messages; those of a training fly with the next exchange.

        Raises:
            ValueError: two nodes would get different models at once.
        """
        self._looks = 0
        pushed = []
        for message in messages:
            self._messages += 1
            number = str(self._messages)
            message.metadata.__dict__["_message_id"] = number
            pushed.append(number)
            if message.metadata.message_type.partition(".")[0] != "train":
                self._replies[number] = self._answer(message)
                continue
            node, waiting = message.metadata.dst_node_id, next(iter(self._queue.values()), message)
            if not FIRST_NODE <= node < FIRST_NODE + self._uavs:
                raise ValueError(f"the ServerApp sends to node {node}; ask grid.get_node_ids() for the nodes")
            if message is waiting:
                split(message.content)  # it must have one model
            elif message.content is not waiting.content and not _alike(message.content, waiting.content):
                raise ValueError(
                    "the ServerApp sends different contents to nodes at once; a broadcast carries one content, so "
                    "models or configurations of single nodes cannot fly"
                )
            if node in self._queue:
                raise ValueError(f"the ServerApp sends two models to node {node} at once; a round carries one")
            self._queue[node] = message
        return pushed

    def pull_messages(self, message_ids: Iterable[str]) -> Iterable[Message]:
        """Replies to messages; if there is none, a round flies first."""
        wanted = list(message_ids)
        if not any(number in self._replies for number in wanted):
            self._fly()
        return [self._replies.pop(number) for number in wanted if number in self._replies]

    def send_and_receive(self, messages: Iterable[Message], *, timeout: float | None = None) -> Iterable[Message]:
        """Send messages, let a round fly, and return the replies, sorted by node."""
        numbers = list(self.push_messages(sorted(messages, key=lambda message: message.metadata.dst_node_id)))
        if self._queue:
            self._fly()
        return [self._replies.pop(number) for number in numbers if number in self._replies]

    # -- the leader's side ------------------------------------------------------------------------------------------

    def reply(self, number: int, node: int, content: RecordDict) -> None:
        """Give the ServerApp a reply of an exchange; one that it does not wait for any more is dropped, as Flower
        does."""
        if (message := self._sent.pop((number, node), None)) is not None:
            self._replies[message.metadata.message_id] = Message(content, reply_to=message)

    def expire(self) -> int:
        """Give the ServerApp an error in place of every reply that it has waited for too long; returns their number."""
        expired = [key for key in self._sent if key[0] <= self.number + 1 - self._expires]
        for key in expired:
            message = self._sent.pop(key)
            error = Error(LOST, "the radio lost it, or it came too late")
            self._replies[message.metadata.message_id] = Message(error, reply_to=message)
        return len(expired)

    @property
    def metrics(self) -> dict[str, float]:
        """Metrics of the newest round that the ServerApp has reported, of those that are finite; those of its own
        evaluation come last."""
        found: dict[str, float] = {}
        for report in self.reports:
            found |= _newest(report)
        return {name: value for name, value in found.items() if math.isfinite(value)}

    def _fly(self) -> None:
        if self._queue:
            self.number += 1
            arrays, rest = split(next(iter(self._queue.values())).content)
            self.asked = Asked(arrays, rest, tuple(sorted(self._queue)))
            self._sent |= {(self.number, node): message for node, message in self._queue.items()}
            self._queue = {}
        self._exchange()


class RunningServer:
    """The thread of a ServerApp. One side runs at a time: the ServerApp until it waits, and then its caller.

    Attributes:
        grid: its Grid. is_over: whether it has ended.
    """

    def __init__(self, app: App, config: dict[str, Any], uavs: int, seed: int, expires: int = 1) -> None:
        client = app.client_app

        def answer(message: Message) -> Message:
            node = message.metadata.dst_node_id
            try:
                reply = client(message, context(node, config, node - FIRST_NODE, uavs))
            except FAILURES as error:
                why = last_line(app.at_fault(error))
                log.warning("the ClientApp of UAV %d failed to answer: %s", node - FIRST_NODE, why)
                return Message(Error(ErrorCode.CLIENT_APP_RAISED_EXCEPTION, why), reply_to=message)
            reply.metadata.__dict__["_message_id"] = ""
            return reply

        self.grid = RadioGrid(uavs, answer, self._exchange, expires)
        self.is_over = False
        self._error: BaseException | None = None
        self._is_ended = False  # by its caller
        self._waits, self._continues = threading.Semaphore(0), threading.Semaphore(0)
        self._generators = Generators(seed)
        self._app, self._config = app, config
        self._thread: threading.Thread | None = None

    def go_on(self, limit_s: float) -> None:
        """Let the ServerApp run until it waits or ends.

        Raises:
            TimeoutError: it did neither. Or what it raises.
        """
        with self._generators:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="meanflock-serverapp", daemon=True)
                self._thread.start()
            else:
                self._continues.release()
            if not self._waits.acquire(timeout=limit_s):
                raise TimeoutError(
                    f"the ServerApp neither sent a model nor ended in {limit_s:g} s of wall time; "
                    f"federation.options.wait_s may be longer, up to {FIT_S:g} s"
                )
        if self._error is not None:
            raise self._error

    def end(self) -> None:
        """Unwind a ServerApp that waits."""
        self._is_ended = True
        self._continues.release()

    def _exchange(self) -> None:
        self._waits.release()
        self._continues.acquire()
        if self._is_ended:
            raise _Probed

    def _run(self) -> None:
        try:
            _serve(self._app.server_app, self.grid, self._config)
        except _Probed:
            pass
        except BaseException as error:  # an app may raise anything
            self._error = self._app.at_fault(error)
        self.is_over = True
        self._waits.release()


def asked_first(app: App, config: dict[str, Any], uavs: int, seed: int, limit_s: float) -> Asked:
    """What a ServerApp sends first.

    Raises:
        ValueError: it sends nothing, or what cannot fly. TimeoutError: it does not begin. Or what it raises.
    """
    server = RunningServer(app, config, uavs, seed)
    server.go_on(limit_s)
    if server.grid.asked is None:
        raise ValueError(
            "the ServerApp ended without sending a model to train; the radio carries trainings only, and the leader "
            "answers queries and evaluations"
        )
    server.end()
    return server.grid.asked


def _serve(server: Any, grid: RadioGrid, config: dict[str, Any]) -> None:
    """Run a ServerApp. A classic one, of `server_fn`, runs in Flower's own loop but without its pool of threads, which
    adds up in the order in which threads end."""
    run = context(1, config)
    with _reporting(grid):
        if server._main is not None:
            server(grid, run)
            return
        from flwr.server.compat.grid_client_proxy import GridClientProxy

        made = server._server_fn(run)
        loop, rounds = classic.init_defaults(made.server, made.config, made.strategy, made.client_manager)
        manager = loop.client_manager()
        for node in grid.get_node_ids():
            manager.register(GridClientProxy(node, grid, 1))

        def wait_for(num_clients: int, timeout: int = 0) -> bool:
            if num_clients > manager.num_available():
                raise ValueError(_too_few(manager.num_available()))
            return True

        manager.wait_for = wait_for
        classic.run_fl(loop, rounds)


@contextmanager
def _reporting(grid: RadioGrid) -> Iterator[None]:
    """Collect the results of strategies in `grid.reports`, and let classic servers ask all clients at once."""

    def all_at_once(kind: str, written: Any, read: Any) -> Any:
        def ask(client_instructions: Any, max_workers: Any, timeout: Any, group_id: int) -> tuple[list[Any], list[Any]]:
            messages = [
                Message(written(ins, True), proxy.node_id, kind, group_id=str(group_id))
                for proxy, ins in client_instructions
            ]
            by_node = {proxy.node_id: proxy for proxy, _ in client_instructions}
            results, failures = list[Any](), list[Any]()
            for reply in grid.send_and_receive(messages):
                if reply.has_error():
                    failures.append(ValueError(reply.error.reason))
                    continue
                result = by_node[reply.metadata.src_node_id], read(reply.content)
                (results if result[1].status.code.value == 0 else failures).append(result)
            return results, failures

        return ask

    def reported(kind: Any) -> Any:
        def made(*arguments: Any, **named: Any) -> Any:
            grid.reports.append(kind(*arguments, **named))
            return grid.reports[-1]

        return made

    replaced = {
        (classic, "fit_clients"): all_at_once(
            "train", compat.fitins_to_recorddict, lambda content: compat.recorddict_to_fitres(content, False)
        ),
        (classic, "evaluate_clients"): all_at_once(
            "evaluate", compat.evaluateins_to_recorddict, compat.recorddict_to_evaluateres
        ),
        (classic, "History"): reported(classic.History),
        (modern, "Result"): reported(Result),
    }
    before = {place: getattr(*place) for place in replaced}
    try:
        for (module, name), value in replaced.items():
            setattr(module, name, value)
        yield
    finally:
        for (module, name), value in before.items():
            setattr(module, name, value)


def _newest(report: Any) -> dict[str, float]:
    """The metrics of the newest round in a result of a strategy, of either API."""
    found: dict[str, float] = {}
    if isinstance(report, Result):
        for table in (
            report.train_metrics_clientapp,
            report.evaluate_metrics_clientapp,
            report.evaluate_metrics_serverapp,
        ):
            record: MetricRecord = table[max(table)] if table else MetricRecord()
            found |= {name: float(value) for name, value in record.items() if isinstance(value, int | float)}
        return found
    for losses in (report.losses_distributed, report.losses_centralized):
        if losses:
            found["loss"] = float(losses[-1][1])
    for table in (report.metrics_distributed_fit, report.metrics_distributed, report.metrics_centralized):
        last = {name: values[-1][1] for name, values in table.items()}
        found |= {name: float(value) for name, value in last.items() if isinstance(value, int | float | np.number)}
    return found


def _alike(one: RecordDict, other: RecordDict) -> bool:
    """Returns whether two messages have the same content."""
    (arrays, rest), (others, also) = split(one), split(other)
    return rest == also and all(np.array_equal(arrays[name], others[name]) for name in arrays)


def _too_few(uavs: int) -> str:
    flying = "one UAV that flies" if uavs == 1 else f"{uavs} UAVs that fly"
    return (
        f"the ServerApp waits for more nodes than the {flying}; fly more with --uavs, or lower the number of nodes "
        "that the strategy wants"
    )
