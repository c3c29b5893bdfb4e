"""`python -m meanflock.launch.forker`: has loaded what all rooms need, and forks them when asked.

The launcher starts it with a socket, whose number is its first argument. When the launcher dies or closes the socket,
it ends all that it has forked; when it dies itself, they end as if the launcher had died.
"""

import importlib
import os
import socket
import sys
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import meanflock.swarm.one_thread  # noqa: F401  # first: NumPy reads the variables once
from meanflock.swarm.errors import needed

with needed("a swarm", "world"):
    from meanflock.agent import __main__ as agent
    from meanflock.agent.node import Agent
    from meanflock.federation.plan import plan_of, plugins_of
    from meanflock.launch import forks, orders
    from meanflock.launch.forks import Forks
    from meanflock.launch.orders import Ended, Loaded, Prepare, Report, Signal, StartOrder
    from meanflock.leader import __main__ as leader
    from meanflock.net.process import READY, Interrupted, main
    from meanflock.swarm import mission, plugins, scenario
    from meanflock.swarm.declared import NO_LEARNER
    from meanflock.swarm.ending import end
    from meanflock.swarm.errors import EXIT_DONE, FAILURES, BadInput
    from meanflock.swarm.wire.control import FLOAT_OF_BITS
    from meanflock.swarm.wire.messages import Welcome
    from meanflock.worldsim import __main__ as world

PROGRAMS: dict[str, Callable[[], None]] = {"worldsim": world.run, "leader": leader.run, "agent": agent.run}


class Server:
    """Carries out the orders of a launcher at the other end of a socket."""

    def __init__(self, channel: socket.socket) -> None:
        self._channel = channel
        self._channel.setblocking(False)
        self._reports: deque[Report] = deque()  # that are still to be sent
        self._interrupted = Interrupted()
        self._forks = Forks()

    def serve(self) -> None:
        """Until the launcher is gone. In a fork it does not return."""
        self._reports.append(Loaded(forks.is_alone()))
        channel = [self._channel.fileno()]
        while not self._interrupted:
            self._reports += [Ended(number, code) for number, code in self._forks.ended()]
            try:
                self._report()
                if not self._take_orders():
                    break
            except ConnectionError:
                break
            self._forks.wait(None, channel, channel if self._reports else [])
        self._forks.end_all()

    def _report(self) -> None:
        with suppress(BlockingIOError):  # a launcher that is stopped reads nothing
            while self._reports:
                self._channel.send(orders.encode(self._reports[0]))
                self._reports.popleft()

    def _take_orders(self) -> bool:
        """Carry out all orders that are here; returns whether the launcher is still there."""
        while True:
            try:
                raw, given, _, _ = socket.recv_fds(self._channel, orders.MOST_BYTES, 1)
            except BlockingIOError:
                return True
            if not raw:
                return False
            order = orders.orders.decode(raw)
            if isinstance(order, Signal):
                self._forks.signal(order.number, order.signal)
            elif isinstance(order, Prepare):
                os.environ.update(order.variables)
                if prepare(Path(order.scenario)):
                    self._reports.append(Loaded(forks.is_alone()))
            elif self._forks.fork(order.number):
                self._channel.close()
                _become(order, given)
            for descriptor in given:
                os.close(descriptor)


def prepare(path: Path) -> bool:
    """Make an agent of a flight, so that the forks find the plug-ins loaded, and what all agents compute computed.

    Plug-ins must be built in, because others may start threads when they are made; they are made by the agents that fly
    them. A learner is made in any case: its libraries are large and slow to import. Returns whether there is one, so
    that this process must be looked at for threads again.
    """
    has_learner = False
    with suppress(BadInput, *FAILURES):  # the room that needs it says so
        flown = scenario.load(path)
        has_learner = flown.training.learner != NO_LEARNER
        needed_plugins = [plugins.find(door, name) for door, name, _ in plugins_of(flown)]
        if all(plugin.reference.startswith("meanflock.") or plugin.kind == "learner" for plugin in needed_plugins):
            plan = mission.starts(flown).astype(FLOAT_OF_BITS[flown.radio.bits_per_float])
            Agent(Welcome(0, "agent-0", (0,), 0, scenario.encode(plan_of(flown).node_scenario), plan))
        if has_learner and "torch" in sys.modules:
            importlib.import_module("torch._dynamo")  # the first optimiser imports it, which takes seconds
    return has_learner


def _become(order: StartOrder, given: list[int]) -> None:
    """Be the program of an order. `given`: descriptor on which it reports that it is ready."""
    log = os.open(order.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    os.dup2(log, 2)
    os.close(log)
    forks.show_as(order.module)
    if given:
        os.environ[READY] = str(given[0])
    sys.argv = [order.module, *order.command[order.command.index("-m") + 2 :]]
    if order.module == "agent":
        forks.batch()
    main(PROGRAMS[order.module])


def run() -> None:
    """Serve the launcher whose socket is the first argument."""
    channel = socket.socket(fileno=int(sys.argv[1]))
    with suppress(BadInput):  # the room that needs it says so
        plugins.load_files(filter(None, os.environ.get(plugins.FILES, "").split(os.pathsep)))
    Server(channel).serve()
    end(EXIT_DONE)


if __name__ == "__main__":
    run()
