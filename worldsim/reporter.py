"""What a run reports: rows of telemetry and events, what was learned, and the summary at the end."""

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.channel.medium import Medium
from meanflock.swarm.model import BEYOND_SENSE
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, Event, Finished
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.members import Member
from meanflock.worldsim.summary import weight_spread
from meanflock.worldsim.telemetry import Outbox, Rows

_BLOCK_ROWS, _BLOCK_STATES = 20, 2500  # of a block of telemetry: so many rows, or more of a small swarm
_BLOCK_ROWS_REALTIME = 2


class Reporter:
    """The telemetry of one run. rows: what is not sent yet. outbox: what is not acknowledged yet."""

    def __init__(
        self, scenario: Scenario, bus: Bus, run: str, flight: Flight, *, block_rows: int | None, keeps: bool
    ) -> None:
        """`block_rows`: of a block at most; None in real time. `keeps`: whether anybody listens."""
        self._bus, self._run, self._fingerprint, self._flight = bus, run, keys.fingerprint(run), flight
        self._declared, self._uavs, self._leader = scenario.declared, scenario.uavs, scenario.federation.leader
        rows = _BLOCK_ROWS_REALTIME
        if block_rows is not None:
            rows = max(_BLOCK_ROWS, min(block_rows, _BLOCK_STATES // scenario.uavs))
        self.rows = Rows(self._fingerprint, scenario.uavs, rows, self._declared)
        self.outbox = Outbox(keeps=keeps)

    def note(self, kind: str, text: str) -> None:
        """An event of this tick."""
        self.rows.note(Event(self._flight.tick, kind, text))

    def learned(
        self, tick: int, asked: Mapping[str, Member], acts: Mapping[str, Act], alive: NDArray[np.bool_], into: Counters
    ) -> None:
        """Takes what was learned: the model of the leader's UAV, and how far those of all `alive` (N,) are apart."""
        if not self._declared.weights:
            return
        models = np.full((self._uavs, self._declared.weights), np.nan)
        for name, act in acts.items():
            if act.models is not None:
                models[asked[name].place] = act.models
        sane = (np.abs(models) < BEYOND_SENSE).all(axis=-1)  # NaN is below nothing
        if (counted := sane & alive).any():
            into.spread = weight_spread(models if counted.all() else models[counted])
            self.rows.report(tick, np.where(sane[self._leader], models[self._leader], 0.0), into.spread)

    def add(self, air: Medium, commands: Commands, links: NDArray[np.int32], counters: Counters) -> None:
        """The row of this tick; the block before it goes out where it is full."""
        if self._flight.last_arrival == self._flight.tick:
            air.meter.mark()
        if self.rows.full:
            self.flush()
        self.rows.add(self._flight, air, commands, links, counters)

    def flush(self) -> None:
        """Whatever rows there are become a block."""
        self.outbox.add(self.rows.take())

    def publish(self) -> None:
        """Sends what may be sent now."""
        for raw in self.outbox.next():
            self._bus.put(keys.telemetry(self._run), raw)

    def finish(self, record: dict[str, Any]) -> Finished:
        """The last block, which is the summary."""
        self.flush()
        finished = Finished(self._fingerprint, self.rows.block, msgspec.json.encode(record))
        self.outbox.add(finished)
        return finished

    def repeat(self, finished: Finished) -> None:
        """Sends the summary once more, past everything that was not acknowledged."""
        self._bus.put(keys.telemetry(self._run), control.encode(finished))
