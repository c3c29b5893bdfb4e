"""The observer's certificate: with it one reads the telemetry, and can neither write nor read anything else."""

import numpy as np
import pytest

from meanflock.groundstation.bridge.observer import Observer
from meanflock.groundstation.launch.station import Kept
from meanflock.swarm.net import keys
from meanflock.swarm.net.access import LEADER, OBSERVER, STATION
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Join, Received, Welcome
from tests.polling import DEADLINE_S
from tests.security.conftest import HELD, HOLD_TICK, PATIENCE_S, RUN, VICTIM, Flight, forged

pytestmark = pytest.mark.processes


def test_an_observer_reads_the_telemetry_and_nothing_else_and_writes_nothing(flight: Flight, undisturbed: str) -> None:
    observer = Observer(flight.client(OBSERVER), DEADLINE_S)
    spy, attacker = flight.client(OBSERVER), flight.client(OBSERVER)
    spied = [keys.sense(RUN, VICTIM), keys.act(RUN, "*"), keys.telemetry(RUN), keys.received(RUN)]
    for key in spied:
        spy.subscribe(key)
    told = control.encode(Received(keys.fingerprint(RUN), 2**20))
    for key in (*spied, keys.act(RUN, VICTIM), keys.act(RUN, OBSERVER), keys.observed(RUN), f"{keys.ROOT}/**"):
        attacker._session.put(key, forged())
        attacker._session.put(key, told)
    attacker._session.delete(keys.act(RUN, VICTIM))
    for name, join in ((VICTIM, Join("agent", 1, HELD)), (LEADER, Join(LEADER, 0)), (STATION, Join(STATION, 0))):
        assert attacker.ask(keys.join(RUN, name), control.encode(join), PATIENCE_S) is None
    attacker.announce(keys.alive(RUN, "agent", VICTIM))
    attacker.announce(keys.alive(RUN, STATION, STATION))
    for session in (spy, attacker):
        answer = session.ask(keys.join(RUN, OBSERVER), control.encode(Join(OBSERVER, 0)), DEADLINE_S)
        assert answer is not None  # and the router has dealt with all that came before
        assert isinstance(control.decode(answer), Welcome)
    summary = flight.land()
    assert spy.receive(0.0) is None
    assert (summary["trajectory_sha256"], summary["lost"], summary["nodes_lost"]) == (undisturbed, 0, 0)
    assert set(summary["dropped_messages"]) <= {"wrong-key"}
    rows = Kept()
    assert observer.listen(rows)["trajectory_sha256"] == undisturbed
    ticks = np.concatenate([block.first_tick + np.arange(len(block.states)) for block in rows.blocks])
    assert ticks.tolist() == list(range(ticks[0], summary["ticks"] + 1))
    assert ticks[0] <= HOLD_TICK
