"""A small swarm under mutual TLS that stands still in mid-flight, so that it can be attacked at leisure."""

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.agent.node import Agent
from meanflock.launch.certs import HOSTS, Authority, names
from meanflock.launch.engine import Engine
from meanflock.launch.processes import free_endpoint
from meanflock.leader.node import Leader
from meanflock.net import keys, tick
from meanflock.net.access import LEADER, OBSERVER, WORLD, Identity
from meanflock.net.bus import Bus
from meanflock.net.client import NodeClient
from meanflock.net.session import ZenohBus
from meanflock.swarm import scenario
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, Join
from tests.polling import DEADLINE_S, until

RUN = "attacked"
UAVS = 5
HELD = 4  # the agent that stands still
HOLD_TICK = 25
SETTINGS = (f"uavs={UAVS}", "seed=7", "duration=6", "federation.period=10")
ME, VICTIM = "agent-3", f"agent-{HELD}"
PATIENCE_S = 0.5


@dataclass(frozen=True)
class Folders:
    """Certificates: the swarm's own, and those of an attacker who calls itself agent-3."""

    good: Path
    foreign: Path  # signed by another authority
    expired: Path
    stranger: Path  # agent-99: signed by the swarm's authority, but no node of this run


@pytest.fixture(scope="session")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Folders:
    authority = Authority("the swarm's")
    issued = Folders(*(tmp_path_factory.mktemp(name) for name in ("good", "foreign", "expired", "stranger")))
    for folder in (issued.good, issued.foreign, issued.expired, issued.stranger):
        authority.write(folder)  # the attacker, too, believes the world's certificate
    for name in (*names(UAVS), OBSERVER):
        authority.issue(issued.good, name, hosts=HOSTS if name == WORLD else ())
    Authority("another").issue(issued.foreign, "agent-3")
    authority.issue(issued.expired, "agent-3", days=-1)
    authority.issue(issued.stranger, "agent-99")
    return issued


@pytest.fixture(scope="session")
def undisturbed() -> str:
    return str(Engine(scenario.load(None, SETTINGS), RUN).complete()["trajectory_sha256"])


def act_in(raw: bytes) -> Act | None:
    return tick.read_act(raw) if raw[1:2] in tick.TYPES else None


def forged() -> bytes:
    """An Act that would send a UAV off at full tilt."""
    return tick.write_act(Act(keys.fingerprint(RUN), HOLD_TICK, np.array([[50.0, -50.0, 0.0, 0.0, 0.0]])))


class Holding:
    """A bus that notes all messages put, and stands still before the reply to one tick."""

    def __init__(self, bus: Bus, go_on: threading.Event) -> None:
        self._bus, self._go_on = bus, go_on
        self.sent: list[bytes] = []
        self.reached = threading.Event()

    def put(self, key: str, payload: bytes) -> None:
        act = act_in(payload)
        if act is not None and act.tick == HOLD_TICK:
            self.reached.set()
            assert self._go_on.wait(DEADLINE_S)
        self.sent.append(payload)
        self._bus.put(key, payload)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)


@dataclass
class Flight:
    """A world in a process of its own, and the nodes in threads of this one."""

    folders: Folders
    log: Path
    endpoint: str = field(default_factory=free_endpoint)
    opened: list[ZenohBus] = field(default_factory=list)
    crew: list[threading.Thread] = field(default_factory=list)
    go_on: threading.Event = field(default_factory=threading.Event)  # for the agent that stands still

    def __post_init__(self) -> None:
        flags = ["--endpoint", self.endpoint, "--run", RUN, "--barrier", str(DEADLINE_S)]
        flags += ["--tls", str(self.folders.good), *(flag for setting in SETTINGS for flag in ("--set", setting))]
        with self.log.open("wb") as log:
            command = [sys.executable, "-m", "meanflock.worldsim", *flags]
            self.world = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log)

    def take_off(self) -> None:
        for uav in range(UAVS):
            bus: Any = self.client(keys.requested_name("agent", uav))
            if uav == HELD:
                bus = self.held = Holding(bus, self.go_on)
            self._board(bus, Join("agent", 1, uav), Agent)
        self._board(self.client(LEADER), Join(LEADER, 0), Leader)
        assert self.held.reached.wait(DEADLINE_S), self.said()

    def client(self, name: str, folder: Path | None = None) -> ZenohBus:
        identity = Identity(folder or self.folders.good, name)
        self.opened.append(ZenohBus.client(self.endpoint, DEADLINE_S, identity))
        return self.opened[-1]

    def said(self) -> str:
        return self.log.read_text()

    def logs(self, *texts: str) -> None:
        until(lambda: all(text in self.said() for text in texts), f"{texts} in the world's log")

    def land(self) -> dict[str, Any]:
        self.go_on.set()
        out, _ = self.world.communicate(timeout=DEADLINE_S)
        assert self.world.returncode == 0, self.said()
        for thread in self.crew:
            thread.join(DEADLINE_S)
        return json.loads(out)

    def settle(self, attacker: ZenohBus, name: str) -> None:
        """Waits until the router has dealt with all that this session of `name` has sent."""
        uav = int(name.rpartition("-")[2])
        answer = attacker.ask(keys.join(RUN, name), control.encode(Join("agent", 1, uav)), DEADLINE_S)
        assert "its agent already" in control.decode(answer).reason

    def close(self) -> None:
        self.go_on.set()
        for bus in self.opened:
            bus.close()
        if self.world.poll() is None:
            self.world.kill()
        self.world.wait()
        self.world.stdout.close()

    def _board(self, bus: Any, join: Join, make: Callable[..., Any]) -> None:
        def serve() -> None:
            client = NodeClient(bus, RUN)
            client.join(join, make, DEADLINE_S)
            client.serve(lambda: self.world.poll() is not None, lambda: False)

        self.crew.append(threading.Thread(target=serve, daemon=True))
        self.crew[-1].start()


@pytest.fixture
def flight(folders: Folders, tmp_path: Path) -> Iterator[Flight]:
    started = Flight(folders, tmp_path / "world.log")
    with closing(started):
        started.take_off()
        yield started
