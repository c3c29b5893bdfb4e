"""What happens to a swarm on a bad day. A mishap is a script: it hurts somebody, yields what must come true, mends."""

import random
import signal
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from meanflock.swarm.net import keys
from meanflock.swarm.net.session import ZenohBus
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Join
from tests.fuzz.mutation import Mutator
from tests.polling import LINK_SURE_S
from tests.soak.swarm import Flock


class Wait(NamedTuple):
    """What a mishap waits for. While a process starts, the flight may be held, lest it be over before."""

    what: str
    met: Callable[[], bool]
    starting: bool = False


Mishap = Iterator[Wait]


STATION_DIES_UNTIL = 0.6  # of the flight: the last one lives long enough for its memory to be judged


class BadDay:
    """Draws mishaps; nobody is hit twice at once, and one leader always stays."""

    def __init__(self, flock: Flock, seed: int) -> None:
        self._flock, self._draw = flock, random.Random(f"mishaps {seed}")
        self.busy: set[str | int] = set()  # UAVs and roles something happens to now
        self.lost = 0  # nodes the world must have counted as lost
        self._kinds: dict[Callable[[], Mishap], int] = {
            self.agent_killed: 6,
            self.agent_frozen_a_moment: 3,
            self.agent_frozen: 1,
            self.leader_killed: 3,
            self.station_killed: 2,
            self.station_interrupted: 1,
            self.station_frozen: 1,
            self.stranger: 2,
        }
        self._bag: list[Callable[[], Mishap]] = []

    def next(self) -> tuple[str, Mishap]:
        """A mishap whose victims are well; each kind comes as often as its weight says, in an order that is drawn."""
        late = self._flock.tick > STATION_DIES_UNTIL * self._flock.ticks
        for attempt in range(2):
            for kind in list(self._bag):
                role = kind.__name__.split("_")[0]
                if role not in self.busy and not (late and kind in (self.station_killed, self.station_interrupted)):
                    self._bag.remove(kind)
                    return kind.__name__.replace("_", " "), kind()
            if not attempt:
                fresh = [kind for kind, weight in self._kinds.items() for _ in range(weight)]
                self._draw.shuffle(fresh)
                self._bag += fresh
        raise AssertionError("strangers are never busy")

    def idle_agent(self) -> int:
        """A UAV whose agent is well."""
        return self._draw.choice([uav for uav in self._flock.agents if uav not in self.busy])

    # -- agents -------------------------------------------------------------------------------------------------------

    def agent_killed(self) -> Mishap:
        """kill -9, and another process in its place."""
        uav = self._taken_uav()
        lost, back = self._flock.count("lost", uav), self._flock.count("rejoined", uav)
        self._flock.agents[uav].kill()
        self.lost += 1
        yield Wait(f"UAV {uav} is lost", lambda: self._flock.count("lost", uav) > lost)
        yield from self._another_agent(uav)
        yield Wait(f"UAV {uav} flies again", lambda: self._flock.count("rejoined", uav) > back)
        self.busy.discard(uav)

    def agent_frozen_a_moment(self) -> Mishap:
        """Shorter than the barrier: everybody waits, nobody is lost."""
        uav = self._taken_uav()
        lost, tick, process = self._flock.count("lost", uav), self._flock.tick, self._flock.agents[uav]
        process.send_signal(signal.SIGSTOP)
        end = time.monotonic() + 0.3
        yield Wait("a moment is over", lambda: time.monotonic() > end)
        process.send_signal(signal.SIGCONT)
        yield Wait("the flight goes on", lambda: self._flock.tick > tick or self._flock.ended)
        assert self._flock.count("lost", uav) == lost, f"UAV {uav} was lost though its agent only paused"
        self.busy.discard(uav)

    def agent_frozen(self) -> Mishap:
        """For longer: it is lost, another takes its place, and it goes home when it wakes."""
        uav = self._taken_uav()
        lost, back, old = self._flock.count("lost", uav), self._flock.count("rejoined", uav), self._flock.agents[uav]
        old.send_signal(signal.SIGSTOP)
        since = time.monotonic()
        self.lost += 1
        yield Wait(f"UAV {uav} is lost", lambda: self._flock.count("lost", uav) > lost)
        yield from self._another_agent(uav)
        yield Wait(f"UAV {uav} flies again", lambda: self._flock.count("rejoined", uav) > back)
        old.send_signal(signal.SIGCONT)
        slept_s = time.monotonic() - since
        yield Wait("the old agent goes home", lambda: old.poll() is not None)
        # Who slept through its lease finds its link closed, and cannot tell that from a world that is gone.
        ends = {0} if slept_s < LINK_SURE_S else {0, 1}
        assert old.poll() in ends, f"the agent that woke after {slept_s:.1f} s ended with {old.poll()}"
        self.busy.discard(uav)

    def _another_agent(self, uav: int) -> Mishap:
        before = self._flock.tokens_of(uav)
        self._flock.start_agent(uav)
        yield Wait(f"an agent for UAV {uav}", lambda: bool(self._flock.tokens_of(uav) - before), starting=True)

    def _taken_uav(self) -> int:
        uav = self.idle_agent()
        self.busy.add(uav)
        return uav

    # -- leaders ------------------------------------------------------------------------------------------------------

    def leader_killed(self) -> Mishap:
        """kill -9 of the one that leads or of the one that stands by, and another stands by."""
        self.busy.add("leader")
        flock, name = self._flock, self._draw.choice(sorted(self._flock.leaders))
        flock.leaders.pop(name).kill()
        self.lost += 1
        yield Wait(f"{name} is gone", lambda: name not in flock.tokens)
        yield from self.another_leader()
        self.busy.discard("leader")

    def another_leader(self) -> Mishap:
        """Starts one, and waits until it has a name."""
        flock, process = self._flock, self._flock.start_leader()

        def unknown() -> set[str]:
            return {name for name in flock.tokens if name.startswith("leader")} - set(flock.leaders)

        yield Wait("a leader stands by", lambda: len(unknown()) == 1, starting=True)
        flock.leaders[unknown().pop()] = process

    # -- the ground station -------------------------------------------------------------------------------------------

    def station_killed(self) -> Mishap:
        """kill -9; the next one goes on in the same folder."""
        return self._station(signal.SIGKILL)

    def station_interrupted(self) -> Mishap:
        """Asked to end; the next one goes on in the same folder."""
        return self._station(signal.SIGTERM)

    def _station(self, number: signal.Signals) -> Mishap:
        self.busy.add("station")
        old = self._flock.station
        old.send_signal(number)
        yield Wait("the station is gone", lambda: old.poll() is not None, starting=True)
        yield Wait("its token is gone", lambda: not self._flock.stations, starting=True)
        self._flock.start_station()
        yield Wait("a station", lambda: bool(self._flock.stations), starting=True)
        # Without one that acknowledges, no more than a window of blocks is told: now they come again.
        tick = self._flock.tick
        yield Wait("telemetry is kept again", lambda: self._flock.tick > tick + 20 or self._flock.ended)
        self.busy.discard("station")

    def station_frozen(self) -> Mishap:
        """The world does not wait for who records."""
        self.busy.add("station")
        process, tick = self._flock.station, self._flock.tick
        process.send_signal(signal.SIGSTOP)
        yield Wait("the flight goes on without it", lambda: self._flock.tick > tick + 60 or self._flock.ended)
        process.send_signal(signal.SIGCONT)
        yield Wait("telemetry is kept again", lambda: self._flock.tick > tick + 200 or self._flock.ended)
        self.busy.discard("station")

    # -- strangers ----------------------------------------------------------------------------------------------------

    def stranger(self) -> Mishap:
        """Connects, asks for a UAV, says what makes no sense under other people's names, and leaves."""
        run, uav = self._flock.children.run, self.idle_agent()
        bus = ZenohBus.client(self._flock.children.endpoint, 20.0)
        try:
            join = control.encode(Join("agent", 1, uav))
            assert bus.ask(keys.join(run, keys.asker("agent", uav)), join, 20.0) is not None
            nonsense = Mutator([join, control.encode(Join("station", 0))], self._draw.getrandbits(32))
            for _ in range(50):
                bus.put(keys.act(run, f"agent-{uav}"), nonsense(0))
        finally:
            bus.close()
        tick = self._flock.tick
        yield Wait("the flight goes on", lambda: self._flock.tick > tick or self._flock.ended)
