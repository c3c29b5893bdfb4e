"""Mishaps of a swarm on processes. Each hurts a node, waits for what must come true, and mends it."""

import random
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from meanflock.net import keys
from meanflock.net.access import Identity
from meanflock.net.session import ZenohBus
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Join
from tests.faults.by_hand import Flight, spool_bytes
from tests.fuzz.mutation import Mutator
from tests.polling import DEADLINE_S, LINK_SURE_S, until


class Mishaps:
    """Draws mishaps for a flight under TLS; several threads may do so. The agent of UAV 0 is never hurt."""

    def __init__(self, flight: Flight, certificates: Path, scratch: Path, seed: int) -> None:
        self.lost = 0  # nodes that the world must have counted as lost
        self.happened: Counter[str] = Counter()
        self._flight, self._certificates, self._scratch = flight, certificates, scratch
        self._random = random.Random(f"mishaps {seed}")
        self._lock = threading.Lock()
        self._well = set(range(1, len(flight.agents)))  # UAVs that nothing happens to now
        self._roles = {"agent", "leader", "station", "stranger"}  # of which the next mishap may be
        self._kinds: dict[Callable[[], None], int] = {
            self.agent_killed: 6,
            self.agent_paused: 3,
            self.agent_frozen: 1,
            self.agent_replaced_while_frozen: 1,
            self.agent_replaced_by_one_that_waits: 1,
            self.leader_killed: 3,
            self.station_killed: 2,
            self.station_terminated: 1,
            self.station_frozen: 1,
            self.stranger: 2,
        }
        self._bag: list[Callable[[], None]] = list(self._kinds)  # each kind once, then by weight
        self._random.shuffle(self._bag)

    def next(self) -> Callable[[], None] | None:
        """A mishap whose victims are well; None if there is none now."""
        with self._lock:
            if not self._bag:
                self._bag = [kind for kind, weight in self._kinds.items() for _ in range(weight)]
                self._random.shuffle(self._bag)
            for kind in self._bag:
                role = kind.__name__.partition("_")[0]
                if role in self._roles and (self._well or role in ("leader", "station")):
                    self._bag.remove(kind)
                    self._roles -= {role} - {"agent"}
                    self.happened[kind.__name__.replace("_", " ")] += 1
                    return kind
            return None

    def over(self, mishap: Callable[[], None]) -> None:
        """Its role may have another."""
        self._roles.add(mishap.__name__.partition("_")[0])

    @contextmanager
    def _an_agent(self) -> Iterator[int]:
        until(lambda: self._well, "an agent that is well")
        with self._lock:
            uav = self._random.choice(sorted(self._well))
            self._well.discard(uav)
        yield uav
        with self._lock:
            self._well.add(uav)

    @contextmanager
    def _is_lost(self, *uavs: int) -> Iterator[None]:
        losses = self._flight.count("lost", uavs)
        yield
        with self._lock:
            self.lost += 1
        self._flight.event("lost", losses + 1, uavs)

    @contextmanager
    def _rejoins(self, *uavs: int) -> Iterator[None]:
        returns = self._flight.count("rejoined", uavs)
        yield
        self._flight.event("rejoined", returns + 1, uavs)

    # -- agents -----------------------------------------------------------------------------------------------------

    def agent_killed(self) -> None:
        """Another process takes its place."""
        with self._an_agent() as uav:
            with self._is_lost(uav):
                self._flight.agents[uav].kill()
            with self._rejoins(uav):
                self._flight.agents[uav] = self._flight.agent(uav)

    def agent_paused(self) -> None:
        """For less than the barrier: all nodes wait, none is lost."""
        with self._an_agent() as uav:
            losses = self._flight.count("lost", (uav,))
            self._flight.agents[uav].send_signal(signal.SIGSTOP)
            time.sleep(0.3)
            self._flight.agents[uav].send_signal(signal.SIGCONT)
            self._flight.flying()
            assert self._flight.count("lost", (uav,)) == losses, f"UAV {uav} was lost though its agent only paused"

    def agent_frozen(self) -> None:
        """It wakes, and takes its own place again."""
        with self._an_agent() as uav:
            agent = self._flight.agents[uav]
            with self._is_lost(uav):
                agent.send_signal(signal.SIGSTOP)
            with self._rejoins(uav):
                agent.send_signal(signal.SIGCONT)
            assert agent.poll() is None, "an agent that woke ended"

    def agent_replaced_while_frozen(self) -> None:
        """It wakes, and goes home."""
        with self._an_agent() as uav:
            frozen, since = self._flight.agents[uav], time.monotonic()
            with self._is_lost(uav):
                frozen.send_signal(signal.SIGSTOP)
            with self._rejoins(uav):
                self._flight.agents[uav] = self._flight.agent(uav)
            frozen.send_signal(signal.SIGCONT)
            slept_s = time.monotonic() - since
            _, err = frozen.communicate(timeout=DEADLINE_S)
            if frozen.returncode != 0:  # it slept through its lease, comes back, and finds its place taken
                assert slept_s >= LINK_SURE_S, err
                assert "has its agent already" in err, err

    def agent_replaced_by_one_that_waits(self) -> None:
        """A successor that comes too early takes over; one without patience goes home."""
        with self._an_agent() as uav:
            patient = self._flight.agent(uav, env={"MEANFLOCK_LOG": "INFO"})
            hasty = self._flight.agent(uav, "--wait", "5")
            _, err = hasty.communicate(timeout=DEADLINE_S)
            assert hasty.returncode == 1
            assert err.startswith("error: the world refused: "), err
            assert "has its agent already" in err, err  # this UAV, or every one
            line = patient.stderr.readline()
            assert "refused for now: " in line, line
            with self._rejoins(uav), self._is_lost(uav):
                self._flight.agents[uav].kill()
            self._flight.agents[uav] = patient

    # -- leaders, stations and strangers ----------------------------------------------------------------------------

    def leader_killed(self) -> None:
        """The one that leads or the one that stands by; another stands by."""
        flight = self._flight
        victim = flight.leaders.pop(self._random.randrange(2))
        with self._is_lost():
            victim.kill()
        with self._rejoins():
            flight.leaders.append(flight.leader())

    def station_killed(self) -> None:
        """Another goes on in the same folder."""
        self._flight.station_again(signal.SIGKILL)

    def station_terminated(self) -> None:
        """Another goes on in the same folder."""
        self._flight.station_again(signal.SIGTERM)

    def station_frozen(self) -> None:
        """The flight goes on, and another station is sent all of it."""
        self._flight.station.send_signal(signal.SIGSTOP)
        out = self._scratch / f"station-{self.happened['station frozen']}"
        second = self._flight.processes.station(out)
        until(lambda: spool_bytes(out) > 20_000, "the second station records")
        self._flight.station.send_signal(signal.SIGCONT)
        second.terminate()
        second.communicate(timeout=DEADLINE_S)
        self._flight.flying()

    def stranger(self) -> None:
        """A thief of a certificate asks for a place that is taken, and sends nonsense under the node's name."""
        with self._an_agent() as uav:
            _, endpoint, _, run, *_ = self._flight.processes.base
            name = f"agent-{uav}"
            bus = ZenohBus.client(endpoint, DEADLINE_S, Identity(self._certificates, name))
            try:
                join = control.encode(Join("agent", 1, uav))
                assert bus.ask(keys.join(run, name), join, DEADLINE_S) is not None
                nonsense = Mutator([join, control.encode(Join("station", 0))], self._random.getrandbits(32))
                for _ in range(50):
                    bus.put(keys.act(run, name), nonsense(0))
            finally:
                bus.close()
            self._flight.flying()
