"""An observer of a live flight gets every row and the summary, and the world does not wait for it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import meanflock as mf
from meanflock.bridge.observer import Observer
from meanflock.launch.processes import free_endpoint
from meanflock.launch.station import RecordingStation, StoredTelemetry
from meanflock.net import keys
from meanflock.net.access import WORLD
from meanflock.net.bus import MemoryNetwork
from meanflock.net.outbox import WINDOW_BLOCKS
from meanflock.net.session import ZenohBus
from meanflock.swarm import scenario
from meanflock.swarm.errors import EXIT_DONE, BusError, RunFailed
from tests.bridge.client import Client
from tests.faults.by_hand import Processes
from tests.memory_swarm import MemorySwarm
from tests.polling import until

RUN = "observed"


def test_an_observer_gets_every_row_though_nobody_acknowledges(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RecordingStation, "_acknowledge", lambda *_: None)
    recorded, seen = StoredTelemetry(), StoredTelemetry()
    flown = scenario.load(None, ["uavs=5", "duration=100", "seed=7"])
    engine = MemorySwarm(flown, RUN, sinks=[recorded])
    engine.network.endpoint().announce(keys.alive(RUN, WORLD, WORLD))
    observer = Observer(engine.network.endpoint(), 0.0)
    assert (observer.run, observer.scenario.uavs, observer.scenario.dt) == (RUN, 5, flown.dt)
    assert len(engine.nodes.listeners) == 1  # the station
    flight = engine.world.flight
    states = [flight.states.copy(), *(flight.states.copy() for _ in engine.fly())]
    assert engine.outbox.waiting > WINDOW_BLOCKS == len(recorded.blocks)
    record = engine.finish(lambda: 0.0)
    assert observer.listen(seen)["trajectory_sha256"] == record["trajectory_sha256"]
    assert np.concatenate([block.states for block in seen.blocks]).tobytes() == np.array(states).tobytes()


def test_an_observer_without_a_flight_says_so() -> None:
    network = MemoryNetwork()
    with pytest.raises(BusError, match="no flight within 0 s"):
        Observer(network.endpoint(), 0.0)


def test_an_observer_notices_the_end_of_a_world_and_drops_what_is_no_telemetry() -> None:
    engine = MemorySwarm(scenario.load(None, ["uavs=2", "duration=1"]), RUN, sinks=[StoredTelemetry()])
    world = engine.network.endpoint()
    world.announce(keys.alive(RUN, WORLD, WORLD))
    observer = Observer(engine.network.endpoint(), 0.0)
    world.put(keys.observed(RUN), b"nonsense")
    world.close()
    with pytest.raises(RunFailed, match="the world is gone"):
        observer.listen(StoredTelemetry())


LISTENS = """
import sys
from meanflock.net.session import ZenohBus
bus = ZenohBus.client(sys.argv[1])
bus.subscribe("observed")
while True:
    if bus.receive(1.0) is not None:
        print("heard", flush=True)
"""


@pytest.mark.processes
def test_an_observer_that_stands_still_does_not_hold_the_world_up() -> None:
    endpoint = free_endpoint()
    hub = ZenohBus.router(endpoint)
    observer = subprocess.Popen([sys.executable, "-c", LISTENS, endpoint], stdout=subprocess.PIPE)
    try:
        os.set_blocking(observer.stdout.fileno(), False)

        def heard() -> bytes | None:
            hub.tell("observed", b"first")
            return observer.stdout.read()

        until(heard, "a message at the observer")
        os.kill(observer.pid, signal.SIGSTOP)
        began = time.perf_counter()
        for _ in range(300):  # 30 MB, far more than all buffers
            hub.tell("observed", bytes(100_000))
        assert time.perf_counter() - began < 5.0  # each would wait for seconds if it waited
    finally:
        observer.kill()
        observer.communicate()
        hub.close()


@pytest.mark.processes
def test_the_command_shows_a_live_flight_to_its_end(processes: Processes, tmp_path: Path) -> None:
    endpoint = processes.base[1]
    flight = ["run", "--realtime", "5", "--uavs", "5", "--duration", "20", "--quiet", "--no-record"]
    flight += ["--endpoint", endpoint, "--out", str(tmp_path)]
    with Client() as client:
        bridge = ["bridge", "mavlink", "--live", endpoint, "--to", str(client.port)]
        started = [processes.start("cli", *line, base=()) for line in (bridge, flight)]

        def over() -> bool:
            client.receive()
            return all(process.poll() is not None for process in started)

        until(over, "the end of the flight and of the bridge")
        assert [process.returncode for process in started] == [EXIT_DONE, EXIT_DONE]
        client.receive()
    (folder,) = tmp_path.iterdir()
    run = mf.open(folder)
    flown = run.states.astype(np.float32)[..., [1, 0, 3, 2]]  # north before east
    for uav in range(5):
        places = list(client.messages_of("LOCAL_POSITION_NED", uav + 1))
        ticks = [round(place.time_boot_ms / 1e3 / run.scenario.dt) for place in places]
        read = np.array([(place.x, place.y, place.vx, place.vy) for place in places], dtype=np.float32)
        assert read.tobytes() == flown[ticks, uav].tobytes()
        assert ticks[-1] == run.summary["ticks"]
