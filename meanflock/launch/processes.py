"""Swarm of processes on this machine: starts the processes, restarts those that die, and ends all of them."""

import logging
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from meanflock.launch.children import Child, Family, Log, environment, kill_all, sweep
from meanflock.launch.forking import Forker
from meanflock.net.access import STATION, Address, Identity
from meanflock.net.process import READY, Restarts, end_all, how_it_ended
from meanflock.net.session import LEASE, ZenohBus
from meanflock.swarm import logs
from meanflock.swarm.errors import EXIT_BAD_INPUT, BadInput, MeanflockError, ProcessDied

log = logging.getLogger("meanflock.launch")

_THREADS = (
    "the import of a plug-in starts a thread, so each process imports all libraries itself: take-off is later, and each"
    " needs the memory of all libraries; start threads in methods, or take --uavs-per-process"
)


def free_endpoint() -> str:
    """A free loopback endpoint."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"tcp/127.0.0.1:{server.getsockname()[1]}"


class Swarm(Family):
    """Context of the processes of a swarm: world, leader and agents. At its end no process is left."""

    def __init__(
        self,
        run: str,
        endpoint: str | None = None,
        tls: Path | None = None,
        log_format: str | None = None,
        forker: Forker | None = None,
    ) -> None:
        """`tls`: folder of certificates, for links that are mutual TLS. `log_format`: form in which the logs of all
        processes are copied to standard error; None: they are not copied, and used for error messages only. `forker`:
        the process that forks the others; None: each is started alone.
        """
        super().__init__()
        self.endpoint = endpoint or free_endpoint()
        self._tls, self._log_format = tls, log_format
        self._run = run
        self._children: list[Child] = []  # the world first
        self._logs: dict[str, Log] = {}
        self._restarts = Restarts()
        self._forker = forker
        self._closed = False
        self._variables: dict[str, str] = {}  # of the environment of all processes
        self._ready = -1  # where the world says that others can join

    @property
    def forks(self) -> bool:
        """Returns whether its processes are forks, which start at once. It waits until it is known."""
        if self._forker is not None and not self._forker.may_fork():
            self._check_forker()
            if not self._forker.gone:
                log.warning(_THREADS)
            self._forker.close()
            self._forker = None
        return self._forker is not None

    def start_world(
        self,
        scenario: str,
        *,
        wait_s: float,
        realtime: float | None,
        rows: int = 1,
        resume: bytes | None = None,
        metrics: Address | None = None,
        steer: Address | None = None,
        has_learner: bool = False,
        lease_s: float | None = None,
    ) -> None:
        """Start the world with a scenario as TOML. `resume`: encoded Resumption. `metrics`: address for Prometheus.
        `steer`: address for MAVLink clients. `has_learner`: whether the scenario has a learner. `lease_s`:
        how long a link may be silent; None, or where the user has set the variable: as long as that says.
        """
        if lease_s is not None and LEASE not in os.environ:
            self._variables[LEASE] = f"{lease_s:g}"
        path = self.folder / "scenario.toml"
        path.write_text(scenario, encoding="utf-8")
        extra = [f"--realtime={realtime or ''}", f"--metrics={metrics or ''}", f"--steer={steer or ''}"]
        extra += ["--uavs-per-process", str(rows)] if self._tls is not None else []
        if resume is not None:
            target = path.with_name("resume.msgpack")
            target.write_bytes(resume)
            extra += ["--resume", str(target)]
        flags = ["--scenario", str(path), "--wait", str(wait_s), "--stations", "1", *extra]
        if self.forks:
            assert self._forker is not None
            self._forker.prepare(str(path), self._variables, has_learner=has_learner)
        self._ready, says = os.pipe()
        try:
            self._start("worldsim", "world", flags, ready=says)
        finally:
            os.close(says)

    def others_can_join(self, timeout_s: float) -> bool:
        """Wait until the world can be joined, or has ended; returns whether it has within this time."""
        return bool(select.select([self._ready], [], [], timeout_s)[0])

    def start_leaders(self, count: int, wait_s: float) -> None:
        """Start a leader and, if `count` is more than one, standbys."""
        for number in range(count):
            self._start("leader", f"standby leader {number}" if number else "leader", ["--wait", str(wait_s)])

    def start_agents(self, firsts: Iterable[int], rows: int, wait_s: float) -> None:
        """Start agents with up to `rows` UAVs each, for which these are the first ones."""
        for number, first in enumerate(firsts):
            who = ["--uav", str(first)] if self._tls is not None else []
            flags = ["--rows", str(rows), "--wait", str(wait_s), *who]
            self._start("agent", f"agent process {number}", flags, log="agents")

    def connect(self, timeout_s: float) -> ZenohBus:
        """Connect this process to the swarm as a listener."""
        identity = Identity(self._tls, STATION) if self._tls is not None else None
        return ZenohBus.client(self.endpoint, timeout_s, identity)

    def check(self) -> None:
        """Copy the output of the processes, and restart agents and leaders that died.

        Raises:
            RunFailed: the world has crashed, or a leader or all agents cannot be kept alive; with the last lines of
                that process. BadInput: a process ended with bad input; with its error.
        """
        self._pass_on()
        self._check_forker()
        for child in self._children:
            if child.process.poll() and not child.given_up:
                self._replace(child)

    def check_ends(self) -> None:
        """Copy the output of the processes after the flight.

        Raises:
            RunFailed: the world has crashed, or a node has ended with bad input, perhaps in the last ticks.
        """
        self._pass_on()
        world, *nodes = self._children
        if world.process.poll():
            raise _failed(world)
        for node in nodes:
            if node.process.poll() == EXIT_BAD_INPUT:
                raise ProcessDied(str(_failed(node)))

    def _check_forker(self) -> None:
        if self._forker is not None and self._forker.died:
            code = self._forker.process.returncode
            raise ProcessDied(f"the process from which all others are forked {how_it_ended(code)}; they ended with it")

    @property
    def world_ended(self) -> bool:
        """Returns whether the process of the world has ended."""
        return self._children[0].process.poll() is not None

    def _replace(self, child: Child) -> None:
        code = child.process.returncode
        assert code is not None
        if child.module == "worldsim" or code == EXIT_BAD_INPUT:
            raise _failed(child)
        if self._restarts.again(child.name):
            log.warning("%s %s; another takes its place", child.name, how_it_ended(code))
            self._launch(child)
            return
        child.given_up = True
        agents = [other for other in self._children if other.module == "agent"]
        if child.module == "leader" or all(other.given_up for other in agents):
            raise _failed(child)
        log.error("%s %s, as often before: it stays away", child.name, how_it_ended(code))

    def interrupt(self) -> None:
        """Ask the world to end the flight now; the other processes follow."""
        if self._children and self._children[0].process.poll() is None:
            self._children[0].process.send_signal(signal.SIGINT)

    def wait(self, timeout_s: float) -> list[str]:
        """Wait until every process has ended by itself; returns the names of those that have not in time."""
        end = time.monotonic() + timeout_s
        while left := [child.name for child in self._children if child.process.poll() is None]:
            if time.monotonic() > end:
                break
            if self._forker is not None:
                self._forker.look(0.1)
            else:
                time.sleep(0.01)
        return left

    def kill(self) -> None:
        """Kill all processes, for a process that ends itself at once."""
        kill_all(self._started() if self._forker is None else [self._forker.process])
        self._folder.delete()

    def close(self) -> None:
        """End all processes: SIGTERM, then SIGKILL. Later calls do nothing."""
        if self._closed:
            return
        self._closed = True
        if self._forker is not None:
            self._forker.close()
        end_all(self._started())
        for process in self._started():
            if process.returncode < 0:  # after SIGKILL of an agent's process its children may still run
                sweep(process.pid)
        self._pass_on()
        if self._ready >= 0:
            os.close(self._ready)
            self._ready = -1
        self._children = []
        super().close()

    def _started(self) -> list["subprocess.Popen[bytes]"]:
        """The processes that were not forked."""
        return [child.process for child in self._children if isinstance(child.process, subprocess.Popen)]

    def _pass_on(self) -> None:
        """Copy whole lines of the output, so that lines of several processes are not mixed."""
        for source in self._logs.values() if self._log_format else ():
            for line in source.whole_lines().split("\n")[:-1]:
                print(line if self._log_format == logs.JSON else f"{source.name}: {line}", file=sys.stderr, flush=True)

    def _start(self, module: str, name: str, flags: list[str], log: str = "", ready: int | None = None) -> None:
        """Start a process. `log`: name of the log that it shares with others."""
        # -P: Python does not import files from the user's working folder.
        command = [sys.executable, "-P", "-m", f"meanflock.{module}", "--endpoint", self.endpoint, "--run", self._run]
        command += [*flags, *([] if self._tls is None else ["--tls", str(self._tls)])]
        command += ["--log-format", self._log_format or logs.TEXT]
        where = log if log and self.forks else name
        output = self._logs.setdefault(where, Log(where, self.folder / f"{where.replace(' ', '-')}.log"))
        child = Child(len(self._children), name, module, command, output)
        self._children.append(child)
        self._launch(child, ready)

    def _launch(self, child: Child, ready: int | None = None) -> None:
        """Start or restart a child. `ready`: descriptor on which it says that it is ready."""
        self._restarts.started(child.name)
        if self.forks:
            assert self._forker is not None
            log_file = str(child.log.path)
            child.process = self._forker.start(child.number, child.module, child.command, log_file, ready)
        else:
            says = {} if ready is None else {READY: str(ready)}
            inherited = [] if ready is None else [ready]
            child.process = self.popen(
                child.command, child.log.path, environment() | self._variables | says, pass_fds=inherited
            )


def _failed(child: Child) -> MeanflockError:
    code = child.process.returncode
    assert code is not None
    if code == EXIT_BAD_INPUT:
        errors = child.log.errors()
        return BadInput(errors[-1] if errors else f"{child.name} ended with bad input:\n{child.log.last_lines()}")
    return ProcessDied(f"{child.name} {how_it_ended(code)}; its last lines:\n{child.log.last_lines()}")
