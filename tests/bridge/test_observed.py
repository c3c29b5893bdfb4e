"""An observer of a live flight gets every row and the summary, and the world does not wait for it."""

import numpy as np
import pytest

from meanflock.groundstation.bridge.observer import Observer
from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept, Station
from meanflock.swarm import scenario
from meanflock.swarm.errors import BusError, RunFailed
from meanflock.swarm.net import keys
from meanflock.swarm.net.access import WORLD
from meanflock.swarm.net.bus import MemoryNetwork
from meanflock.worldsim.reporting import WINDOW_BLOCKS

RUN = "observed"


def test_an_observer_gets_every_row_though_nobody_acknowledges(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Station, "_acknowledge", lambda *_: None)
    recorded, seen = Kept(), Kept()
    flown = scenario.load(None, ["uavs=5", "duration=100", "seed=7"])
    engine = Engine(flown, RUN, sinks=[recorded])
    engine.network.endpoint().announce(keys.alive(RUN, WORLD, WORLD))
    observer = Observer(engine.network.endpoint(), 0.0)
    assert (observer.run, observer.scenario.uavs, observer.scenario.dt) == (RUN, 5, flown.dt)
    assert len(engine.world.listeners) == 1  # the station
    flight = engine.world.flight
    states = [flight.states.copy(), *(flight.states.copy() for _ in engine.fly())]
    assert engine.world.outbox.waiting > WINDOW_BLOCKS == len(recorded.blocks)
    record = engine.world.finish(lambda: 0.0)
    assert observer.listen(seen)["trajectory_sha256"] == record["trajectory_sha256"]
    assert np.concatenate([block.states for block in seen.blocks]).tobytes() == np.array(states).tobytes()


def test_an_observer_without_a_flight_says_so() -> None:
    network = MemoryNetwork()
    with pytest.raises(BusError, match="no flight within 0 s"):
        Observer(network.endpoint(), 0.0)


def test_an_observer_notices_the_end_of_a_world_and_drops_what_is_no_telemetry() -> None:
    engine = Engine(scenario.load(None, ["uavs=2", "duration=1"]), RUN, sinks=[Kept()])
    world = engine.network.endpoint()
    world.announce(keys.alive(RUN, WORLD, WORLD))
    observer = Observer(engine.network.endpoint(), 0.0)
    world.put(keys.observed(RUN), b"nonsense")
    world.close()
    with pytest.raises(RunFailed, match="the world is gone"):
        observer.listen(Kept())
