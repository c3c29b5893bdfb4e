"""A flight under fire: mutated messages reach every receiver of a swarm between its ticks and in the middle of them."""

import json
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import psutil

from meanflock.launch.station import RecordingStation
from meanflock.leader.node import Leader
from meanflock.net import keys, tick
from meanflock.net.bus import Delivery, MemoryNetwork
from meanflock.net.client import NodeClient
from meanflock.recording.recorder import Recorder
from meanflock.results.run_folder import RunFolder
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import (
    Acknowledgement,
    Act,
    Event,
    Finished,
    Join,
    Ready,
    Refusal,
    Sense,
    Stop,
    Telemetry,
)
from tests.faults.conftest import RUN, Lab, saying, scenario
from tests.fuzz.mutation import Mutator
from tests.memory_swarm import MemorySwarm
from tests.swarm.examples import RAW, read, written

NUMBER = keys.fingerprint(RUN)
ROWS = 2  # UAVs a node
NODES = ("agent-0", "agent-2", "agent-4", "leader", "leader.2")
TICKS = 125
HARMLESS = (
    Ready,
    Acknowledgement,
    Join,
)  # what may be let in though it changes nothing: said twice, or by who may say it


class Broken(AssertionError):
    """A promise that mutated messages broke; the text has the message in hexadecimal."""


def besieged(clusters: int) -> Scenario:
    """Short, with rounds, two of which are open at any time, and shared states."""
    settings = (f"duration={TICKS / 10}", "federation.state_period=30", f"federation.clusters={clusters}")
    return scenario(*settings, method="mfgfl-hf")


def recorded(flown: Scenario) -> tuple[list[bytes], dict[str, Any]]:
    engine = MemorySwarm(flown, RUN, uavs_per_node=ROWS, leaders=2)
    said: list[bytes] = []
    spy = engine.network.endpoint()
    spy.handler = lambda delivery: said.append(delivery.payload)
    for key in (keys.act(RUN, "*"), keys.sense(RUN, "*"), keys.telemetry(RUN), keys.received(RUN)):
        spy.subscribe(key)
    summary = engine.complete()
    kept: dict[tuple[str, int], bytes] = {}
    for raw in said:  # of every kind and size a few: the first of a length, roughly
        kept.setdefault((type(read(raw)).__name__, len(raw) // 64), raw)
    own = [Ready(NUMBER), Acknowledgement(NUMBER, 3), Stop(NUMBER, "x")]
    own += [Join(role, int(role == "agent")) for role in ("agent", "leader", "station")]
    return [*kept.values(), *map(control.encode, own), *RAW.values()], summary


class Siege:
    def __init__(self, count: int, seed: int, clusters: int = 1) -> None:
        self.thrown: Counter[str] = Counter()  # by receiver
        self.outcome: Counter[str] = Counter()  # by reason of the drop, or what else became of it
        self.rss: list[int] = []  # bytes, after each tick
        self._flown = besieged(clusters)
        corpus, self.expected = recorded(self._flown)
        self._next = Mutator(corpus, seed)
        self._a_tick = -(-count // TICKS)
        self._lab = Lab(self._flown, uavs_per_node=ROWS, leaders=2)
        self._world = self._lab.world
        self._nodes = self._lab.engine.nodes
        self._spokes = [self._lab.client_of(name) for name in NODES]
        self._turn, self._ambushed = 0, -1
        self._answers: list[bytes] = []

    def fly(self) -> dict[str, Any]:
        """The flight, to its end; its summary.

        Raises:
            Broken: an exception, a drop that was not counted, or an answer that cannot be one.
        """
        process = psutil.Process()
        with tempfile.TemporaryDirectory() as out, ExitStack() as outputs:
            folder = outputs.enter_context(RunFolder(Path(out), "run", self._flown))
            recorder = outputs.enter_context(Recorder(self._flown, RUN, Path(out) / "run" / "recording.rrd"))
            self._sinks = [folder, recorder]
            self._target = self._station()
            self._ambush()
            for _ in self._lab.engine.fly():
                self._assault(self._a_tick - self._a_tick // 2)
                self.rss.append(process.memory_info().rss)
            summary = self._lab.engine.finish()
            self.rss.append(process.memory_info().rss)
        return summary

    def _ambush(self) -> None:
        """From now on, half of the messages come while the world waits for answers."""
        bus = self._lab.bus_of(NODES[1])
        ((key, reply),) = bus._subscriptions.items()

        def first_the_attack(key: str, raw: bytes) -> bool:
            now = self._world.flight.tick
            if self._nodes._barrier.standing and now > self._ambushed:
                self._ambushed = now
                self._assault(self._a_tick // 2)
            return reply(key, raw)

        bus.subscribe(key, first_the_attack)

    def _assault(self, count: int) -> None:
        receivers = (self._at_world, self._at_world, self._at_node, self._at_station)
        for _ in range(count):
            raw = self._next(self._world.flight.tick)
            self._turn += 1
            try:
                message = self._decoded(raw)
                receivers[self._turn % len(receivers)](raw, message)
            except Exception as error:
                raise Broken(f"{type(error).__name__}: {error}: {raw.hex()}") from error

    def _decoded(self, raw: bytes) -> Any:
        self.thrown["codec"] += 1
        try:
            return read(raw)
        except MessageRejected as error:
            self.outcome[f"codec: {error.reason}"] += 1
            return None

    def _at_world(self, raw: bytes, message: Any) -> None:
        names = [*self._nodes.members._by_name, "agent-77", "nobody"]
        name = names[self._turn // 32 % len(names)]
        delivery = Delivery("message", keys.act(RUN, name), raw)
        match self._turn // 4 % 8:
            case 0:
                role, uav = (message.role, message.uav) if isinstance(message, Join) else ("agent", -1)
                delivery = Delivery(
                    "question", keys.join(RUN, keys.requested_name(role, uav)), raw, self._answers.append
                )
            case 1:
                delivery = Delivery("message", keys.received(RUN), raw)
            case _ if self._is_its_word(name, raw, message):
                self.outcome["not thrown: a node's own word"] += 1
                return
        self.thrown["world"] += 1
        before = self._world.counters.drops.total()
        self._nodes.handle(delivery)
        dropped = self._world.counters.drops.total() - before
        if dropped != 1 and not (dropped == 0 and isinstance(message, HARMLESS)):
            raise Broken(f"{dropped} drops counted for {type(message).__name__} under {delivery.key}: {raw.hex()}")
        for answer in self._answers:
            control.decode(answer)
        self._answers.clear()

    def _is_its_word(self, name: str, raw: bytes, message: Any) -> bool:
        """Whether that is what the node may say in this moment: whoever can say it under its key is that node."""
        barrier, member = self._nodes._barrier, self._nodes.members.get(name)
        if member is None or member.lost:
            return False
        if isinstance(message, Event | Refusal):
            return True
        if not isinstance(message, Act) or not barrier.standing or name not in barrier.missing:
            return False
        try:
            barrier._replies.read(member, self._world.flight.tick, raw)
        except MessageRejected:
            return False
        return True

    def _at_node(self, raw: bytes, message: Any) -> None:
        """The node is told everything but what only the world could have said."""
        client = self._spokes[self._turn // 4 % len(self._spokes)]
        is_new = isinstance(message, Stop) or (isinstance(message, Sense) and message.tick > client._last_tick)
        if is_new and message.run == NUMBER:
            self.outcome["not thrown: the world's own word"] += 1
            return
        self.thrown["leader" if isinstance(client._node, Leader) else "agent"] += 1
        before = client.dropped.total()
        client.handle(Delivery("message", keys.sense(RUN, "x"), raw))
        again = isinstance(message, Sense) and message.run == NUMBER and message.tick == client._last_tick
        again = again and self._is_for(client, raw)
        if client.dropped.total() - before != (0 if again else 1):
            raise Broken(f"a node let in {type(message).__name__}: {raw.hex()}")

    def _is_for(self, client: NodeClient, raw: bytes) -> bool:
        """Whether a request fits the rows of a node, and names UAVs of the swarm."""
        try:
            tick.read_sense(raw, client._blank.copy(), client._nodes)
        except MessageRejected:
            return False
        return True

    def _station(self) -> RecordingStation:
        return RecordingStation(MemoryNetwork().endpoint(), RUN, self._sinks, uavs=self._flown.uavs)

    def _at_station(self, raw: bytes, message: Any) -> None:
        """A station of its own, with real files: telemetry that fits is kept, whatever numbers it has."""
        self.thrown["station"] += 1
        before = self._target.dropped.total()
        self._target.handle(Delivery("message", keys.telemetry(RUN), raw))
        if self._target.dropped.total() == before:
            if not isinstance(message, Telemetry | Finished):
                raise Broken(f"the station let in {type(message).__name__}: {raw.hex()}")
            self.outcome["station: kept, it fits"] += 1
            self._target = self._station()  # the next block may have any number again


class Insider:
    """A flight one of whose nodes is possessed: before every honest reply it sends mutations of it."""

    def __init__(self, count: int, seed: int, who: str, clusters: int = 1) -> None:
        self._count, self._seed, self._who, self._flown = count, seed, who, besieged(clusters)
        self.let_in = 0

    def fly(self) -> dict[str, Any]:
        """The flight, to its end; its summary, as JSON can hold it."""

        def possessed(act: Act) -> Iterator[Act | bytes]:
            mutate = Mutator([written(act)], self._seed + act.tick)
            for _ in range(-(-self._count // TICKS)):
                yield mutate(act.tick)
            self.let_in += self._who in lab.engine.nodes._barrier.acts
            yield act

        lab = saying(self._flown, self._who, possessed)
        return json.loads(json.dumps(lab.fly(), allow_nan=False))
