"""A swarm of processes that can be hurt and mended, and what it tells of itself while it flies."""

import random
import subprocess
import time
from collections import Counter
from pathlib import Path

import psutil

from benchmarks.processes import Children
from meanflock.swarm.errors import BusError, MessageRejected
from meanflock.swarm.net import keys
from meanflock.swarm.net.session import ZenohBus
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Event, Finished, Telemetry

BARRIER_S = 6.0
PERIOD = 40  # ticks between rounds
Process = subprocess.Popen[bytes]


def scenario(uavs: int, ticks: int, seed: int) -> Scenario:
    """The paper's mission that is not over when all have arrived, with a fault of the model every 400 ticks or so."""
    draw = random.Random(f"script {seed}")
    script = []
    for tick in range(100, ticks - 100, 400):
        uav, other = draw.sample(range(1, uavs), 2)  # UAV 0 averages: without it no round would be
        script += [
            f'{{kind="partition", tick={tick}, duration_s=8.0, uavs=[{uav}]}}',
            f'{{kind="jam", tick={tick + 90}, duration_s=5.0, uavs=[{uav}, {other}]}}',
            f'{{kind="gust", tick={tick + 170}, duration_s=2.0, acceleration=[0.3, -0.2]}}',
            f'{{kind="pause", tick={tick + 250}, duration_s=3.0, uavs=[{other}]}}',
        ]
    settings = [f"uavs={uavs}", f"seed={seed}", f"federation.period={PERIOD}", f"duration={ticks / 10}"]
    return load(None, [*settings, 'stop="duration"', f"faults=[{', '.join(script)}]"], method="mfgfl-hf")


class Flock:
    """World, ground station, two leaders and an agent a UAV. A context manager that leaves no process behind."""

    def __init__(self, uavs: int, ticks: int, seed: int, out: Path) -> None:
        self.scenario, self.out, self.ticks = scenario(uavs, ticks, seed), out, ticks
        self.children = Children(f"soak-{seed}")
        self.tick = -1  # of the last row told
        self.finished = False  # the summary has been told
        self.events: list[Event] = []
        self.tokens: set[str] = set()  # of agents, leaders and the station, by name
        self._next_block = 0
        file = self.children.folder / "scenario.toml"
        from meanflock.groundstation.results.run_folder import to_toml

        file.write_text(to_toml(self.scenario), encoding="utf-8")
        self.world = self.children.start(
            "worldsim", "--scenario", str(file), "--barrier", str(BARRIER_S), "--stations", "1"
        )
        self.bus = self._connected()
        self.bus.subscribe(keys.telemetry(self.children.run))
        self.bus.watch(keys.alive(self.children.run, "*", "*"))
        self.leaders: dict[str, Process] = {}
        self.agents: dict[int, Process] = {}
        self.station = self.start_station()

    def __enter__(self) -> "Flock":
        return self

    def __exit__(self, *_: object) -> None:
        self.bus.close()
        self.children.close()

    def start_agent(self, uav: int) -> None:
        """An agent that asks for one UAV."""
        self.agents[uav] = self.children.start("agent", "--uav", str(uav))

    def start_leader(self) -> Process:
        """Another leader; its name is that of the next token of a leader."""
        return self.children.start("leader")

    def start_station(self) -> Process:
        """The ground station, in the folder of the one before."""
        self.station = self.children.start("groundstation", "--out", str(self.out), "--rerun", "", "--resume", "latest")
        return self.station

    def listen(self, seconds: float) -> None:
        """Takes in what is told, for so long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            delivery = self.bus.receive(left)
            if delivery is None:
                continue
            if delivery.kind == "message":
                self._hear(delivery.payload)
            else:
                role, name = delivery.key.split("/")[-2:]
                if role != "world":
                    (self.tokens.add if delivery.kind == "alive" else self.tokens.discard)(name)

    def _hear(self, raw: bytes) -> None:
        try:
            message = control.decode(raw)
        except MessageRejected:
            return
        if isinstance(message, Finished):
            self.finished = True
        if isinstance(message, Telemetry) and message.block >= self._next_block:  # a new station is told old ones again
            self._next_block = message.block + 1
            self.tick = message.first_tick + len(message.states) - 1
            self.events += message.events

    @property
    def ended(self) -> bool:
        """Whether the flight is over. The world waits for who records, not for who listens here: it may have left
        before the last of what it told arrived."""
        return self.finished or self.world.poll() == 0

    def count(self, kind: str, *uavs: int) -> int:
        """How many events of a kind were told, of exactly these UAVs."""
        return sum(event.kind == kind and event.uavs == uavs for event in self.events)

    def tokens_of(self, uav: int) -> set[str]:
        """The agents that are alive and began as that UAV's."""
        return {name for name in self.tokens if name.partition(".")[0] == f"agent-{uav}"}

    @property
    def stations(self) -> set[str]:
        """The ground stations that are alive."""
        return {name for name in self.tokens if name.startswith("station")}

    def kinds(self) -> Counter[str]:
        """How many events of every kind were told."""
        return Counter(event.kind for event in self.events)

    def said(self) -> str:
        """The last lines the processes wrote to standard error, but for what they dropped."""
        told = []
        for path in sorted(self.children.folder.glob("*.log"), key=lambda path: int(path.stem)):
            lines = [line for line in path.read_text(errors="replace").splitlines() if line and "dropped" not in line]
            told += [f"{path.stem}: {line}" for line in lines[-8:]]
        return "\n".join(told)

    def watched(self) -> dict[str, psutil.Process]:
        """The processes whose memory is sampled, by a name that is another after a restart."""
        found = {"world": self.world, f"station {self.station.pid}": self.station}
        found |= {f"agent {uav} ({process.pid})": process for uav, process in self.agents.items()}
        found |= {f"{name} ({process.pid})": process for name, process in self.leaders.items()}
        return {name: psutil.Process(p.pid) for name, p in found.items() if p.poll() is None}

    def _connected(self) -> ZenohBus:
        end = time.monotonic() + 60.0
        while True:
            try:
                return ZenohBus.client(self.children.endpoint, 5.0)
            except BusError:
                self.children.check()
                if time.monotonic() > end:
                    raise
