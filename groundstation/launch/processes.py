"""Swarm of processes on this machine: starts the processes, restarts those that die, and ends all of them."""

import logging
import os
import signal
import site
import socket
import sys
import time
from pathlib import Path

from meanflock import swarm
from meanflock.agent import prefork
from meanflock.groundstation.launch.children import Child, Family, has_members, kill_all, sweep
from meanflock.swarm import logs
from meanflock.swarm.errors import EXIT_BAD_INPUT, BadInput, MeanflockError, ProcessDied, printable_lines
from meanflock.swarm.net.access import STATION, Address, Identity
from meanflock.swarm.net.session import ZenohBus
from meanflock.swarm.process import Restarts, end_all, how_it_ended

log = logging.getLogger("meanflock.launch")

_FORKED = "agents"  # all of them, and the process they are forked from
# Variables of processes that are started by hand. Here the launcher sets these options.
_FLAGS = ("ENDPOINT", "RUN", "TLS", "WAIT", "SCENARIO", "SET", "STATIONS", "REALTIME", "METRICS", "UAVS_PER_PROCESS")
_OURS = {f"MEANFLOCK_{flag}" for flag in (*_FLAGS, "RESUME", "ROWS", "UAV", "COUNT")}


def free_endpoint() -> str:
    """A free loopback endpoint."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"tcp/127.0.0.1:{server.getsockname()[1]}"


class Swarm(Family):
    """Context of the processes of a swarm: world, leader and agents. At its end no process is left."""

    def __init__(
        self, run: str, endpoint: str | None = None, tls: Path | None = None, log_format: str | None = None
    ) -> None:
        """`tls`: folder of certificates, for links that are mutual TLS. `log_format`: form in which the logs of all
        processes are copied to standard error; None: they are not copied, and used for error messages only.
        """
        super().__init__()
        self.endpoint = endpoint or free_endpoint()
        self._tls, self._log_format = tls, log_format
        self._run = run
        self._children: list[Child] = []  # the world first
        self._restarts = Restarts()

    def start_world(
        self,
        scenario: str,
        *,
        wait_s: float,
        realtime: float | None,
        rows: int = 1,
        resume: bytes | None = None,
        metrics: Address | None = None,
    ) -> None:
        """Start the world with a scenario as TOML. `resume`: encoded Resumption. `metrics`: address for Prometheus."""
        path = self.folder / "scenario.toml"
        path.write_text(scenario, encoding="utf-8")
        extra = [f"--realtime={realtime or ''}", f"--metrics={metrics or ''}"]
        extra += ["--uavs-per-process", str(rows)] if self._tls is not None else []
        if resume is not None:
            target = path.with_name("resume.msgpack")
            target.write_bytes(resume)
            extra += ["--resume", str(target)]
        self._start("worldsim", "world", ["--scenario", str(path), "--wait", str(wait_s), "--stations", "1", *extra])

    def start_leaders(self, count: int, wait_s: float) -> None:
        """Start a leader and, if `count` is more than one, standbys."""
        for number in range(count):
            self._start("leader", f"standby leader {number}" if number else "leader", ["--wait", str(wait_s)])

    def start_agents(self, uavs: int, rows: int, wait_s: float) -> None:
        """Start agents with `rows` UAVs each; where a fork is safe, from one process."""
        processes = -(-uavs // rows)
        together = processes if prefork.SAFE else 1
        for number in range(0, processes, together):
            who = ["--uav", str(number * rows)] if self._tls is not None else []
            name = f"agent process {number}" if together == 1 else _FORKED
            self._start("agent", name, ["--count", str(together), "--rows", str(rows), "--wait", str(wait_s), *who])

    def connect(self, timeout_s: float) -> ZenohBus:
        """Connect this process to the swarm as a listener."""
        identity = Identity(self._tls, STATION) if self._tls is not None else None
        return ZenohBus.client(self.endpoint, timeout_s, identity)

    def check(self, flying: bool) -> None:
        """Copy the output of the processes, and restart agents and leaders that died. `flying`: whether the flight has
        begun; before it, the parent of the agents is restarted too.

        Raises:
            RunFailed: the world has crashed, or a leader or all agents cannot be kept alive; with the last lines of
                that process. BadInput: a process ended with bad input; with its error.
        """
        self._pass_on()
        for child in self._children:
            if child.process.poll() and not child.given_up:
                self._replace(child, flying)

    def check_world(self) -> None:
        """Copy the output of the processes; raises RunFailed if the world has crashed."""
        self._pass_on()
        if self._children[0].process.poll():
            raise _failed(self._children[0])

    @property
    def world_ended(self) -> bool:
        """Returns whether the process of the world has ended."""
        return self._children[0].process.poll() is not None

    def _replace(self, child: Child, flying: bool) -> None:
        code = child.process.returncode
        if child.module == "worldsim" or code == EXIT_BAD_INPUT:
            raise _failed(child)
        if child.name == _FORKED and code > 0:  # it restarts its children itself
            raise _failed(child)
        if child.name == _FORKED and (flying or has_members(child.process.pid)):  # its children continue without it
            child.given_up = True
            log.warning("what starts agents %s: none is started again", how_it_ended(code))
        elif self._restarts.again(child.name):
            log.warning("%s %s; another takes its place", child.name, how_it_ended(code))
            self._launch(child)
        else:
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
            time.sleep(0.01)
        return left

    def kill(self) -> None:
        """Kill all processes, for a process that ends itself at once."""
        kill_all([child.process for child in self._children])
        self._folder.cleanup()

    def close(self) -> None:
        """End all processes: SIGTERM, then SIGKILL."""
        end_all([child.process for child in self._children])
        for child in self._children:
            if child.process.returncode < 0:  # after SIGKILL of the parent its children may still run
                sweep(child.process.pid)
        self._pass_on()
        self._children = []
        super().close()

    def _pass_on(self) -> None:
        """Copy whole lines of the output, so that lines of several processes are not mixed."""
        for child in self._children if self._log_format else ():
            with child.log.open("rb") as log:
                log.seek(child.passed_on)
                text = log.read()
            whole = text[: text.rfind(b"\n") + 1]
            child.passed_on += len(whole)
            for line in printable_lines(whole.decode(errors="replace")).split("\n")[:-1]:
                print(line if self._log_format == logs.JSON else f"{child.name}: {line}", file=sys.stderr, flush=True)

    def _start(self, module: str, name: str, flags: list[str]) -> None:
        # -P: Python does not import files from the user's working folder.
        command = [sys.executable, "-P", "-m", f"meanflock.{module}", "--endpoint", self.endpoint, "--run", self._run]
        command += [*flags, *([] if self._tls is None else ["--tls", str(self._tls)])]
        command += ["--log-format", self._log_format or logs.TEXT]
        child = Child(name, module, command, self.folder / f"{name.replace(' ', '-')}.log")
        self._launch(child)
        self._children.append(child)

    def _launch(self, child: Child) -> None:
        """Start or restart a child."""
        self._restarts.started(child.name)
        child.process = self.popen(child.command, child.log, {**_environment(), **_import_path()})


def _failed(child: Child) -> MeanflockError:
    if child.process.returncode == EXIT_BAD_INPUT:
        why = child.errors()
        return BadInput(why[-1] if why else f"{child.name} ended with bad input:\n{child.last_lines()}")
    return ProcessDied(f"{child.name} {how_it_ended(child.process.returncode)}; its last lines:\n{child.last_lines()}")


def _environment() -> dict[str, str]:
    """The environment of a child: that of this process without variables that would change what it flies."""
    return {name: text for name, text in os.environ.items() if name not in _OURS}


def _import_path() -> dict[str, str]:
    """PYTHONPATH with which a child finds the packages of a checkout that is not installed."""
    root = str(Path(swarm.__file__).parents[2])
    if root in site.getsitepackages():
        return {}
    return {"PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH", "")]))}
